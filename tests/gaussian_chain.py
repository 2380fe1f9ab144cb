"""The serial Gaussian chain, and the best of its linear-Gaussian channels in closed form.

ω ~ N(0, 1), U = −(ω − a)², x and a continuous. Let u and v be the squared correlations of (ω, x)
and (x, a), kᵢ = 1/(2βᵢ). The best a of squared correlation uv with ω has E[U] = −(1 − uv), and
I(Ω;X) = −½ ln(1 − u), I(X;A) = −½ ln(1 − v), so that

    J = −(1 − uv) + k₁ ln(1 − u) + k₂ ln(1 − v).

∂J = 0 says v(1 − u) = k₁ and u(1 − v) = k₂: hence v − u = k₁ − k₂ and
u² − (1 + k₂ − k₁) u + k₂ = 0, of which the larger root is a maximum. Its discriminant is
Δ = (1 − k₁ − k₂)² − 4k₁k₂, not negative where √k₁ + √k₂ ≤ 1. No information gives J = −1.

This is the best pair of linear-Gaussian channels and a test of such; other channels do better.
"""

import math

import torch
from gymnasium.spaces import Box
from torch import nn

from bra import Agent, Task, World
from bra.channels import Channel
from bra.channels.spaces import gaussian

LINE = Box(-math.inf, math.inf, (1,))


def best_linear(beta_perception: float, beta_action: float) -> tuple[float, float, float]:
    """J, u and v of the best pair."""
    k_1, k_2 = 0.5 / beta_perception, 0.5 / beta_action
    if math.sqrt(k_1) + math.sqrt(k_2) > 1:
        return -1.0, 0.0, 0.0
    root = math.sqrt((1 - k_1 - k_2) ** 2 - 4 * k_1 * k_2)
    u, v = (1 + k_2 - k_1 + root) / 2, (1 + k_1 - k_2 + root) / 2
    objective = -(1 - u * v) + k_1 * math.log(1 - u) + k_2 * math.log(1 - v)
    return (objective, u, v) if objective > -1 else (-1.0, 0.0, 0.0)


class Chase(Task):
    """A number to be met."""

    observation_space = LINE
    action_space = LINE

    def sample(self, count, generator):
        state = torch.randn((count, 1), generator=generator)
        return World(state, state)

    def utility(self, state, action):
        return -(state - action).square().sum(-1)

    def grid(self, points):
        line = torch.linspace(-4, 4, points, dtype=torch.double)
        weight = (-line.square() / 2).exp()
        return -(line.unsqueeze(-1) - line).square(), weight / weight.sum()


class Linear(Channel):
    """N(y; slope · c, s²)."""

    def __init__(self, condition_space, outcome_space, slope=1.0, scale=0.5):
        super().__init__(condition_space, outcome_space)
        self.slope = nn.Parameter(torch.tensor(slope))
        self.log_scale = nn.Parameter(torch.tensor(math.log(scale)))

    def forward(self, condition):
        mean = self.slope * condition
        return gaussian(mean, self.log_scale.expand_as(mean), 1)


def linear_objective(agent: Agent) -> tuple[float, float, float]:
    """J, I(Ω;X) and I(X;A) of an agent of two such channels, exact, in nats."""
    channels = (agent.perception, agent.action)
    (w, s), (v, t) = ((c.slope.item(), c(torch.zeros(1, 1)).stddev.item()) for c in channels)
    percept = w**2 + s**2
    action = v**2 * percept + t**2
    first, second = 0.5 * math.log(percept / s**2), 0.5 * math.log(action / t**2)
    utility = -(1 - 2 * v * w + action)
    costs = first / agent.beta_perception + second / agent.beta_action
    return utility - costs, first, second
