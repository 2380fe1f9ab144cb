"""J and its terms for given channels: exact where that is possible, estimated otherwise.

With known states, a noiseless sensor, enumerable percepts and enumerable actions nothing is
estimated.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from bra.chain import Chain
from bra.evaluation.errors import standard_errors
from bra.evaluation.shortfall import StratifiedSample
from bra.evaluation.tables import Tables, tabulate_chain
from bra.information import mutual_information
from bra.objective import Objective, sampled_objective, table_objective
from bra.tasks import FiniteStateTask, FiniteTask, Task, World, knows_signals
from bra.tasks.finite import utility_table

TAKEN = 32
"""Actions that are taken in a world where they can be neither enumerated nor shared by states."""


@dataclass(frozen=True)
class Evaluation:
    """Channels as tables, and J.

    Attributes:
        objective: J and its terms.
        percept_given_state: p(x|ω), (W, X), over known states, or p(x|ξ), (N, X), over sampled
            worlds.
        action_given_percept: p(a|x), (X, A).
        exact: Whether nothing was sampled.
        standard_error: Of J and its terms; None if they are exact.
        action_given_percept_and_state: p(a|x,ω), (X, W, A), over known states, or p(a|x,ξ),
            (X, N, A), over sampled worlds, where actions look at the signal again, else None.
    """

    objective: Objective[float]
    percept_given_state: Tensor
    action_given_percept: Tensor
    exact: bool
    standard_error: Objective[float] | None = None
    action_given_percept_and_state: Tensor | None = None

    @property
    def action_given_state(self) -> Tensor:
        """p(a|ω) = Σ_x p(x|ω) p(a|x), (W, A), or p(a|ξ), (N, A), over sampled worlds."""
        looks = self.action_given_percept_and_state
        if looks is not None:
            return torch.einsum("wx,xwa->wa", self.percept_given_state, looks)
        return self.percept_given_state @ self.action_given_percept


@torch.no_grad()
def evaluate(chain: Chain, world: World) -> Evaluation:
    """Evaluates J in float64, at the chain's prices.

    Known states weigh what their prior says, and the signals of a state share its weight: with a
    noiseless sensor p(x|ω) is a row of the channel, with a noisy one the mean over the signals at
    hand. Where states are not known every world weighs the same.

    Information over sampled signals falls short to first order (see `bra.evaluation.shortfall`),
    which is made good for enumerable outcomes. For densities the estimate is left as it is: low by
    O(1/N) while p(y|ξ) overlap, and never above log N.

    Args:
        chain: What is evaluated.
        world: Signals of the task's known states, or N ≥ 2 sampled worlds, on the channels'
            device.
    """
    sample = _stratify(chain.task, world)
    tables = tabulate_chain(chain, world.observation, sample.weights)
    terms, errors = _judge(chain, world, sample, tables)
    percepts = tables.percept_given_signal
    return Evaluation(
        terms.item(),
        sample.means(percepts) if isinstance(chain.task, FiniteStateTask) else percepts,
        tables.action_given_percept,
        errors is None,
        None if errors is None else errors.item(),
        _looks(chain.task, sample, tables),
    )


def _looks(task: Task, sample: StratifiedSample, tables: Tables) -> Tensor | None:
    """p(a|x,ω), (X, W, A), where actions look again; p(a|x,ξ) where a state has one signal."""
    looks = tables.second_look
    if looks is None or knows_signals(task) or not isinstance(task, FiniteStateTask):
        return looks
    # Of states that hardly lead to a percept, too.
    percepts = tables.percept_given_signal.clamp_min(torch.finfo(looks.dtype).tiny)
    rows = percepts.mT.unsqueeze(-1) * looks
    weights = sample.means(percepts).mT.unsqueeze(-1)
    return torch.stack([sample.means(row) for row in rows]) / weights


def chain_terms(chain: Chain, world: World) -> Objective[Tensor]:
    """J and its terms as `evaluate` has them, as tensors.

    With known states, and percepts and actions that can be enumerated, it runs under
    `torch.func.vmap`.
    """
    sample = _stratify(chain.task, world)
    tables = tabulate_chain(chain, world.observation, sample.weights)
    return _judge(chain, world, sample, tables)[0]


def _judge(
    chain: Chain, world: World, sample: StratifiedSample, tables: Tables
) -> tuple[Objective[Tensor], Objective[Tensor] | None]:
    """J and its terms, and their standard errors; None if they are exact."""
    utilities = _utilities(chain.task, world.state, tables)
    terms = _terms(chain, sample, tables, utilities)
    if knows_signals(chain.task) and tables.enumerable_percepts and tables.enumerable_actions:
        return terms, None
    errors = standard_errors(chain, sample, tables, utilities, terms)
    return replace(terms, standard_error=errors.objective), errors


def _stratify(task: Task, world: World) -> StratifiedSample:
    """Signals by known states, or as one group."""
    device = world.observation.device
    if isinstance(task, FiniteStateTask):
        return StratifiedSample(world.state.to(device), task.prior.to(device))
    one = torch.ones(1, dtype=torch.double, device=device)
    return StratifiedSample(torch.zeros(len(world.state), dtype=torch.long, device=device), one)


def _terms(
    chain: Chain, sample: StratifiedSample, tables: Tables, utilities: Tensor
) -> Objective[Tensor]:
    """J and its terms over the signals, with what sampled entropies fall short by made good."""
    percepts, behaviour = tables.percept_given_signal, tables.action_given_signal
    sampled = table_objective(
        sample.weights,
        percepts,
        tables.action_given_percept if tables.second_look is None else tables.second_look,
        utilities,
        chain.beta_perception,
        chain.beta_action,
        chain.beta_direct,
    )
    known, noiseless = isinstance(chain.task, FiniteStateTask), knows_signals(chain.task)
    of_percepts, of_actions = (
        enumerable and not noiseless  # where the one signal of a state has no spread
        for enumerable in (tables.enumerable_percepts, tables.enumerable_actions)
    )
    percept, percept_given = _shortfall(sample, percepts, of_percepts)
    action, action_given = _shortfall(sample, behaviour, of_actions)
    acted, looked = action, sampled.direct_information
    if looked is not None and of_actions:
        # I(X;A) = H(X) + H(A) − H(X,A), and I(ξ;A|X) = H(X,A) − H(X) − H(A|X,ξ).
        pairs, _ = sample.shortfall(tables.pairs_given_signal)
        acted, looked = percept + action - pairs, looked + pairs - percept

    def of_states(rows: Tensor, overall: Tensor, within: Tensor) -> Tensor:
        return mutual_information(sample.mass, sample.means(rows)) + overall - within

    costs = (sampled.perception_information + percept, sampled.action_information + acted)
    prices = (chain.beta_perception, chain.beta_action)
    return Objective(
        sampled_objective(sampled.expected_utility, *costs, *prices, looked, chain.beta_direct),
        sampled.expected_utility,
        *costs,
        looked,
        of_states(behaviour, action, action_given) if known else None,
        of_states(percepts, percept, percept_given) if known and not noiseless else None,
        None if known else mutual_information(sample.weights, behaviour) + action,
    )


def _shortfall(sample: StratifiedSample, rows: Tensor, falls: bool) -> tuple[Tensor, Tensor]:
    """See `StratifiedSample.shortfall`; zeros where nothing falls short, or nobody can tell."""
    if falls:
        return sample.shortfall(rows)
    return rows.new_zeros(()), rows.new_zeros(())


def _utilities(task: Task, states: Tensor, tables: Tables) -> Tensor:
    """U(ω, a), (N, A), float64.

    Of all actions where they can be enumerated, or states are known; else the mean over `TAKEN`
    actions of every world, evenly spread over p(a|ξ_i), as constant rows.
    """
    if isinstance(task, FiniteTask):
        return task.payoffs.to(states.device)[states]
    if isinstance(task, FiniteStateTask) or tables.enumerable_actions:
        return utility_table(task, states, tables.actions).double()
    behaviour = tables.action_given_signal
    shifts = torch.rand(len(behaviour), 1, dtype=behaviour.dtype, device=behaviour.device)
    levels = (torch.arange(TAKEN, device=behaviour.device) + shifts) / TAKEN
    chosen = torch.searchsorted(behaviour.cumsum(-1), levels).clamp(max=behaviour.shape[-1] - 1)
    worlds = states.repeat_interleave(TAKEN, 0)
    earned = task.utility(worlds, tables.actions[chosen.flatten()]).double()
    return earned.reshape(-1, TAKEN).mean(1, keepdim=True).expand(behaviour.shape)
