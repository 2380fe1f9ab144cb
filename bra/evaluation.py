"""J and its terms for two given channels: exact where that is possible, estimated otherwise.

Both channels are written as tables over a support. The support of an enumerable channel is all
its outcomes; that of a density is a sample of its marginal, on which p(y|c)/p(y) is exact and
sums become Monte Carlo integrals. With known states, enumerable percepts and enumerable actions
nothing is estimated.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.channels import Channel
from bra.distributions import probabilities
from bra.information import mutual_information
from bra.objective import Objective, table_objective
from bra.tasks import Task, World
from bra.tasks.base import utility_table

SUPPORT_SIZE = 2048
"""Points by which the support of a density is sampled."""


@dataclass(frozen=True)
class Evaluation:
    """Channels as tables, and J.

    Attributes:
        objective: J and its terms.
        percept_given_state: p(x|ξ), (W, X) over known states or (N, X) over sampled worlds.
        action_given_percept: p(a|x), (X, A).
        exact: Whether nothing was sampled.
    """

    objective: Objective[float]
    percept_given_state: Tensor
    action_given_percept: Tensor
    exact: bool

    @property
    def action_given_state(self) -> Tensor:
        """p(a|ξ) = Σ_x p(x|ξ) p(a|x)."""
        return self.percept_given_state @ self.action_given_percept


@torch.no_grad()
def evaluate_channels(
    task: Task,
    perception: Channel,
    action: Channel,
    beta_perception: float,
    beta_action: float,
    world: World,
    prior: Tensor | None,
) -> Evaluation:
    """Evaluates J in float64.

    Over sampled worlds information is that of the N worlds at hand. The entropy of a mean of N
    distributions falls short of the entropy of their expectation by
    ½ Σ_y Var[p(y|ξ)] / (N p(y)) + O(N⁻²) (second-order Taylor expansion of the entropy). This
    first-order bias is added back for enumerable outcomes. For densities the estimate is left as
    it is: low by O(1/N) while p(y|ξ) overlap, and never above log N.

    Args:
        task: What the channels are to do.
        perception: p(x|ξ).
        action: p(a|x).
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        world: All states of the task, or N ≥ 2 sampled worlds, on the channels' device.
        prior: p(ω) of all states, (W,), or None for sampled worlds.
    """
    count = len(world.observation)
    weights = torch.full((count,), 1 / count).double() if prior is None else prior
    weights = weights.to(world.observation.device)

    percept_given = perception(world.observation)
    percepts, percept_table = tabulate(weights, percept_given)
    action_given = action(percepts)
    actions, action_table = tabulate(weights @ percept_table, action_given)
    behaviour = percept_table @ action_table
    utilities = _utilities if prior is not None else _sampled_utilities
    terms = table_objective(
        weights,
        percept_table,
        action_table,
        utilities(task, world.state, actions, behaviour),
        beta_perception,
        beta_action,
    )
    if prior is None:
        perception_bias = entropy_bias(percept_table, percept_given)
        action_bias = entropy_bias(behaviour, action_given)
        terms = Objective(
            terms.objective - perception_bias / beta_perception - action_bias / beta_action,
            terms.expected_utility,
            terms.perception_information + perception_bias,
            terms.action_information + action_bias,
            mutual_information(weights, behaviour) + action_bias,
        )
    enumerable = percept_given.has_enumerate_support and action_given.has_enumerate_support
    exact = enumerable and prior is not None
    return Evaluation(terms.item(), percept_table, action_table, exact)


def tabulate(weights: Tensor, conditional: Distribution) -> tuple[Tensor, Tensor]:
    """A channel as a table over a support.

    For a density, the support y_t is a stratified sample of p(y) = Σ_c w_c p(y|c), each point
    standing for a mass v_t, and the table is v_t p(y_t|c)/p(y_t), rows normalised.

    Args:
        weights: w_c, (C,), float64, summing to one.
        conditional: p(y|c), batch shape (C,).

    Returns:
        Support (Y, *event shape), and table (C, Y), float64, rows summing to one.
    """
    if conditional.has_enumerate_support:
        support = conditional.enumerate_support(expand=False).flatten()
        table = probabilities(conditional).double()
        return support, table / table.sum(-1, keepdim=True)
    massive = weights > 0
    draws = -(-SUPPORT_SIZE // int(massive.sum()))
    support = conditional.sample((draws,))[:, massive].flatten(0, 1)
    mass = weights[massive].repeat(draws) / draws
    log_density = conditional.log_prob(support.unsqueeze(1)).double().T
    log_marginal = torch.logsumexp(weights.log().unsqueeze(-1) + log_density, 0)
    return support, (mass.log() + log_density - log_marginal).softmax(-1)


def entropy_bias(rows: Tensor, outcome: Distribution) -> Tensor:
    """½ Σ_y s²_y / (N p̂(y)), what the entropy of the mean p̂ of N sampled rows falls short by.

    Args:
        rows: N distributions, (N, Y), N ≥ 2; s² is their sample variance.
        outcome: A distribution over the same outcomes; 0 is returned if they are no finite set.
    """
    if not outcome.has_enumerate_support:
        return rows.new_zeros(())
    variance, mean = torch.var_mean(rows, 0)
    return 0.5 * torch.where(mean > 0, variance / mean, 0.0).sum() / len(rows)


def _utilities(task: Task, states: Tensor, actions: Tensor, behaviour: Tensor) -> Tensor:
    """U(ω, a) for all pairs, (W, A), float64."""
    return utility_table(task, states, actions).double()


def _sampled_utilities(task: Task, states: Tensor, actions: Tensor, behaviour: Tensor) -> Tensor:
    """U(ω_i, a_i) of one action a_i ~ p(a|ξ_i) per world, as constant rows (N, A), float64."""
    chosen = actions[torch.multinomial(behaviour, 1).squeeze(-1)]
    return task.utility(states, chosen).double().unsqueeze(-1).expand(behaviour.shape)
