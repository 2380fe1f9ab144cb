"""The paper's rule on predator-prey by hand, in JAX and NumPy, and agents that follow it."""

import os

os.environ["XLA_FLAGS"] = (  # read when JAX starts
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1 "
    + os.environ.get("XLA_FLAGS", "")
)

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch.optim import SGD

from bra import Agent, Population, PredatorPrey
from bra.channels import MLP, Multinomial
from bra.marginals import ExactMarginals
from bra.randomness.draws import Uniform
from bra.randomness.keys import update_key
from bra.tasks.datamodule import WorldStream
from bra.update_rules import ScoreFunction, UpdateRule

try:
    import jax
    import jax.numpy as jnp
except ImportError:
    sys.exit('error: JAX is missing; pip install "bra[benchmarks]"')

PERCEPTS, HIDDEN = 13, 20
PRICES = BETA_PERCEPTION, BETA_ACTION = 8.0, 10.0
RATES = PERCEPTION_RATE, ACTION_RATE = 0.006, 0.014


def make_agents(
    size: int, compile: bool, rule: UpdateRule | None = None, optimizer: Any = SGD
) -> Agent | Population:
    """Agents of the paper, of seeds 0, 1, …."""
    own = {
        "compile": compile,
        "perception": partial(MLP, hidden=[HIDDEN], bias=False),
        "action": Multinomial,
        "percepts": PERCEPTS,
        "beta_perception": BETA_PERCEPTION,
        "beta_action": BETA_ACTION,
        "update_rule": rule or ScoreFunction(),
        "marginals": ExactMarginals(),
        "perception_optimizer": partial(optimizer, lr=PERCEPTION_RATE),
        "action_optimizer": partial(optimizer, lr=ACTION_RATE),
        "seed": 0,
    }
    if size == 1:
        return Agent(PredatorPrey(), **own)
    return Population(PredatorPrey(), replicas=size, **own)


class JaxRule:
    """The same rule, written for JAX.

    Parameters are (V, W, η) of one agent: (20, 4), (13, 20) and (8, 13).
    """

    def __init__(self) -> None:
        task = PredatorPrey()
        self.signals = jnp.asarray(task.observations.numpy())
        self.utilities = jnp.asarray(task.utilities.float().numpy())
        self.prior = jnp.asarray(task.prior.float().numpy())
        self.gradient = jax.grad(self.loss)

    def loss(self, parameters: Any, state: Any, numbers: Any) -> Any:
        """−(log p(x|ξ) + log p(a|x)) j of one encounter, j held constant.

        Args:
            parameters: V, W and η.
            state: ω.
            numbers: What percept and action are drawn with, two for `draw`.
        """
        first, second, eta = parameters

        def perceive(signals: Any) -> Any:
            return jax.nn.log_softmax(jnp.tanh(signals @ first.T) @ second.T)

        log_percept = perceive(self.signals[state])
        log_actions = jax.nn.log_softmax(jnp.concatenate([jnp.zeros((1, PERCEPTS)), eta]).T)
        percept = self.draw(log_percept, numbers[0])
        action = self.draw(log_actions[percept], numbers[1])
        scores = (log_percept[percept], log_actions[percept, action])
        percept_marginal = self.prior @ jnp.exp(perceive(self.signals))
        action_marginal = percept_marginal @ jnp.exp(log_actions)
        perception_cost = scores[0] - jnp.log(percept_marginal[percept])
        action_cost = scores[1] - jnp.log(action_marginal[action])
        j = self.utilities[state, action]
        j = j - perception_cost / BETA_PERCEPTION - action_cost / BETA_ACTION
        return -(scores[0] + scores[1]) * jax.lax.stop_gradient(j)

    def numbers(self, key: Any) -> Any:
        """Three numbers in [0, 1)."""
        return jax.random.uniform(key, (3,))

    def draw(self, log_probabilities: Any, number: Any) -> Any:
        """The first outcome whose cumulated probability exceeds the number."""
        cumulated = jnp.cumsum(jnp.exp(log_probabilities))
        return (cumulated <= number * cumulated[-1]).sum()

    def update(self, parameters: Any, key: Any, count: Any) -> Any:
        """One update of one agent.

        Args:
            parameters: V, W and η.
            key: Of the agent.
            count: Number of the update.
        """
        numbers = self.numbers(jax.random.fold_in(key, count))
        state = self.draw(jnp.log(self.prior), numbers[0])
        gradients = self.gradient(parameters, state, numbers[1:])
        rates = (PERCEPTION_RATE, PERCEPTION_RATE, ACTION_RATE)
        return tuple(p - r * g for p, r, g in zip(parameters, rates, gradients, strict=True))

    @partial(jax.jit, static_argnums=(0, 3))
    def updates(self, parameters: Any, keys: Any, count: int) -> Any:
        """Several updates of several agents."""

        def step(parameters: Any, number: Any) -> tuple[Any, None]:
            return jax.vmap(self.update, (0, 0, None))(parameters, keys, number), None

        return jax.lax.scan(step, parameters, jnp.arange(count))[0]


class NumPyRule:
    """The same rule for one agent in NumPy, with the derivatives by hand."""

    def __init__(self) -> None:
        task = PredatorPrey()
        self.signals = task.observations.numpy().astype(np.float32)
        self.utilities = task.utilities.float().numpy()
        self.prior = task.prior.float().numpy()
        self.cumulated = self.prior.cumsum()

    def gradient(self, first: Any, second: Any, eta: Any, state: int, numbers: Any) -> Any:
        """Of −(log p(x|ξ) + log p(a|x)) j of one encounter, j held constant."""
        hidden = np.tanh(self.signals @ first.T)
        log_percepts = log_softmax(hidden @ second.T)
        percepts = np.exp(log_percepts)
        log_actions = log_softmax(np.vstack([np.zeros((1, PERCEPTS), np.float32), eta]).T)
        actions = np.exp(log_actions)
        percept = self.draw(percepts[state], numbers[0])
        action = self.draw(actions[percept], numbers[1])
        marginal = self.prior @ percepts
        perception_cost = log_percepts[state, percept] - np.log(marginal[percept])
        action_cost = log_actions[percept, action] - np.log(marginal @ actions[:, action])
        j = self.utilities[state, action]
        j = j - perception_cost / BETA_PERCEPTION - action_cost / BETA_ACTION
        by_logits = j * percepts[state]
        by_logits[percept] -= j
        by_action = j * actions[percept]
        by_action[action] -= j
        by_hidden = (by_logits @ second) * (1 - hidden[state] ** 2)
        by_eta = np.zeros_like(eta)
        by_eta[:, percept] = by_action[1:]
        return np.outer(by_hidden, self.signals[state]), np.outer(by_logits, hidden[state]), by_eta

    def draw(self, probabilities: Any, number: Any) -> int:
        """The first outcome whose cumulated probability exceeds the number."""
        cumulated = probabilities.cumsum()
        return min(int((cumulated <= number * cumulated[-1]).sum()), len(probabilities) - 1)


def log_softmax(logits: Any) -> Any:
    """Of the last dimension."""
    logits = logits - logits.max(-1, keepdims=True)
    return logits - np.log(np.exp(logits).sum(-1, keepdims=True))


class PlainJaxRule(JaxRule):
    """The same as it is written first, with what JAX offers for drawing."""

    def __init__(self) -> None:
        super().__init__()
        with_value = jax.value_and_grad(self.loss)
        self.gradient = lambda *inputs: with_value(*inputs)[1]

    def numbers(self, key: Any) -> Any:
        """Three keys."""
        return jax.random.split(key, 3)

    def draw(self, log_probabilities: Any, number: Any) -> Any:
        """A draw with a key."""
        return jax.random.categorical(number, log_probabilities)


def stacked_parameters(agents: Agent | Population) -> list[torch.Tensor]:
    """V, W and η of every agent."""
    channels = (agents.perception, agents.action)
    found = [parameter for channel in channels for parameter in channel.parameters()]
    return found if isinstance(agents, Population) else [p.unsqueeze(0) for p in found]


def to_jax(parameters: Sequence[torch.Tensor]) -> tuple[Any, ...]:
    """The same as arrays of JAX."""
    return tuple(jnp.asarray(parameter.detach().cpu().numpy()) for parameter in parameters)


def check_gradients(rule: JaxRule, own: NumPyRule, size: int = 64) -> None:
    """Makes sure that all sides climb the same gradient at the same encounters."""
    population = make_agents(size, compile=False)
    with torch.no_grad():  # actions that are all alike would hide much
        population.action.eta.normal_(generator=torch.Generator().manual_seed(0))
    world = WorldStream(population.task, 1, population.world_seeds, "world")[0]
    population.find_gradient(world)
    numbers = [Uniform(update_key(seed, "update", 0))((2,)) for seed in population.world_seeds]
    stacks = stacked_parameters(population)
    found = jax.vmap(rule.gradient)(
        to_jax(stacks), jnp.asarray(world.state[:, 0].numpy()), jnp.asarray(torch.stack(numbers))
    )
    by_hand = [
        own.gradient(
            *(s[i].detach().numpy() for s in stacks), int(world.state[i]), numbers[i].numpy()
        )
        for i in range(size)
    ]
    for stack, gradient, third in zip(stacks, found, zip(*by_hand, strict=True), strict=True):
        np.testing.assert_allclose(np.asarray(gradient), stack.grad, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(np.stack(third), stack.grad, rtol=1e-4, atol=1e-6)
