"""J and its terms for two given channels: exact where that is possible, estimated otherwise.

Both channels are written as tables over a support. The support of an enumerable channel is all
its outcomes; that of a density is a sample of its marginal, on which p(y|c)/p(y) is exact and
sums become Monte Carlo integrals. With known states, a noiseless sensor, enumerable percepts and
enumerable actions nothing is estimated.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import probabilities
from bra.evaluation.shortfall import Strata
from bra.information import mutual_information
from bra.objective import Objective, Price, table_objective
from bra.randomness.generators import counted_generator
from bra.tasks import FiniteStateTask, FiniteTask, Task, World, knows_signals
from bra.tasks.base import utility_table

EVALUATION_WORLDS = 1024
SUPPORT_SIZE = 2048
"""Points by which the support of a density is sampled."""


@dataclass(frozen=True)
class Evaluation:
    """Channels as tables, and J.

    Attributes:
        objective: J and its terms.
        percept_given_state: p(x|ω), (W, X), over known states, or p(x|ξ), (N, X), over sampled
            worlds.
        action_given_percept: p(a|x), (X, A).
        exact: Whether nothing was sampled.
    """

    objective: Objective[float]
    percept_given_state: Tensor
    action_given_percept: Tensor
    exact: bool

    @property
    def action_given_state(self) -> Tensor:
        """p(a|ω) = Σ_x p(x|ω) p(a|x), (W, A), or p(a|ξ), (N, A), over sampled worlds."""
        return self.percept_given_state @ self.action_given_percept


def evaluation_worlds(task: Task, seed: int) -> World:
    """Worlds to evaluate on: all states where the sensor is noiseless, else worlds drawn for it.

    Of known states equally many signals are drawn each. They are the same for the same seed, and
    others than any update draws.
    """
    if knows_signals(task):
        return task.states()
    generator = counted_generator(seed, 0, "evaluation world")
    if not isinstance(task, FiniteStateTask):
        return task.sample(EVALUATION_WORLDS, generator)
    states = len(task.prior)
    each = max(2, EVALUATION_WORLDS // states)
    state = torch.arange(states).repeat_interleave(each)
    return World(state, task.observe(state, generator))


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

    Known states weigh what their prior says, and the signals of a state share its weight: with a
    noiseless sensor p(x|ω) is a row of the channel, with a noisy one the mean over the signals at
    hand. Where states are not known every world weighs the same.

    Information over sampled signals falls short to first order (see `bra.evaluation.shortfall`),
    which is made good for enumerable outcomes. For densities the estimate is left as it is: low by
    O(1/N) while p(y|ξ) overlap, and never above log N.

    Args:
        task: What the channels are to do.
        perception: p(x|ξ).
        action: p(a|x).
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        world: Signals of the task's known states, or N ≥ 2 sampled worlds, on the channels'
            device.
        prior: p(ω) of known states, (W,), or None for sampled worlds.
    """
    terms, percept_table, action_table, enumerated = channel_terms(
        task, perception, action, beta_perception, beta_action, world, prior
    )
    exact = enumerated and prior is not None and knows_signals(task)
    return Evaluation(terms.item(), percept_table, action_table, exact)


def channel_terms(
    task: Task,
    perception: Channel,
    action: Channel,
    beta_perception: Price,
    beta_action: Price,
    world: World,
    prior: Tensor | None,
) -> tuple[Objective[Tensor], Tensor, Tensor, bool]:
    """J and its terms as float64 tensors; arguments as `evaluate_channels`.

    With known states, and percepts and actions that can be enumerated, it runs under
    `torch.func.vmap`.

    Returns:
        The terms; p(x|ω) or p(x|ξ), and p(a|x), as tables; and whether they are enumerated.
    """
    known = prior is not None
    group = (
        world.state if known else world.observation.new_zeros(len(world.state), dtype=torch.long)
    )
    mass = torch.ones(1, dtype=torch.double) if prior is None else prior
    device = world.observation.device
    strata = Strata(group.to(device), mass.to(device))
    weights = strata.weights

    percept_given = perception(world.observation)
    percepts, percept_table = tabulate(weights, percept_given)
    action_given = action(percepts)
    actions, action_table = tabulate(weights @ percept_table, action_given)
    behaviour = percept_table @ action_table
    utilities = _utilities if known else _sampled_utilities
    terms = table_objective(
        weights,
        percept_table,
        action_table,
        utilities(task, world.state, actions, behaviour),
        beta_perception,
        beta_action,
    )
    percept_bias, percept_bias_given = _shortfall(strata, percept_table, percept_given)
    action_bias, action_bias_given = _shortfall(strata, behaviour, action_given)
    noiseless = knows_signals(task)
    state_information = None
    if known:
        percept_table, behaviour = strata.means(percept_table), strata.means(behaviour)
        end_to_end = mutual_information(strata.mass, behaviour) + action_bias - action_bias_given
        if not noiseless:
            state_information = (
                mutual_information(strata.mass, percept_table) + percept_bias - percept_bias_given
            )
    else:
        end_to_end = mutual_information(weights, behaviour) + action_bias
    terms = Objective(
        terms.objective - percept_bias / beta_perception - action_bias / beta_action,
        terms.expected_utility,
        terms.perception_information + percept_bias,
        terms.action_information + action_bias,
        end_to_end,
        state_information,
    )
    enumerated = percept_given.has_enumerate_support and action_given.has_enumerate_support
    return terms, percept_table, action_table, enumerated


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


def _shortfall(strata: Strata, rows: Tensor, outcome: Distribution) -> tuple[Tensor, Tensor]:
    """See `Strata.shortfall`; zeros where outcomes are no finite set."""
    if outcome.has_enumerate_support:
        return strata.shortfall(rows)
    return rows.new_zeros(()), rows.new_zeros(())


def _utilities(task: Task, states: Tensor, actions: Tensor, behaviour: Tensor) -> Tensor:
    """U(ω, a) for all pairs, (W, A), float64."""
    if isinstance(task, FiniteTask):
        return task.payoffs.to(states.device)[states]
    return utility_table(task, states, actions).double()


def _sampled_utilities(task: Task, states: Tensor, actions: Tensor, behaviour: Tensor) -> Tensor:
    """U(ω_i, a_i) of one action a_i ~ p(a|ξ_i) per world, as constant rows (N, A), float64."""
    chosen = actions[torch.multinomial(behaviour, 1).squeeze(-1)]
    return task.utility(states, chosen).double().unsqueeze(-1).expand(behaviour.shape)
