"""The optimum that an agent is compared with: the best that its sensor allows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor

from bra.blahut_arimoto import General, Serial, discretised, general, rate_distortion, serial
from bra.information import kl_divergence, mutual_information
from bra.tasks import FiniteTask, Task
from bra.tasks.signals import SignalTable, UnknownSensorError, signal_tables

Prices = tuple[float, float]
TINY = 1e-300


@dataclass(frozen=True)
class Reference:
    """What there is to compare an agent with at one pair of prices.

    Attributes:
        optimum: The best serial solution that the sensor allows: with noise, of the problem whose
            states are the signals; None if there is none.
        upper_bound: No agent has a larger J; None without a table of utilities. Certified where
            `error` is 0, else as far as the error goes.
        error: By how much J of `optimum` may be wrong, 0 where it is exact.
        without_noise: The best serial solution if the sensor had no noise; None if it has none.
        reason: Why there is no optimum; empty if there is one.
    """

    optimum: Serial | None = None
    upper_bound: float | None = None
    error: float = 0.0
    without_noise: Serial | None = None
    reason: str = ""

    @property
    def objective(self) -> float | None:
        """J of the optimum."""
        return None if self.optimum is None else float(self.optimum.objective)

    @property
    def objective_without_noise(self) -> float | None:
        """J of the optimum without sensor noise."""
        return None if self.without_noise is None else float(self.without_noise.objective)

    @property
    def tight_bound(self) -> float | None:
        """No agent with so many percepts has a larger J, as far as `upper_bound` is certain."""
        if self.optimum is None or self.upper_bound is None:
            return None
        return min(float(self.optimum.tight_bound) + self.error, self.upper_bound)

    @property
    def bound(self) -> float | None:
        """The least of all bounds there are."""
        return self.upper_bound if self.tight_bound is None else self.tight_bound

    @property
    def note(self) -> str:
        """One line on what is wanting, if anything is."""
        if self.optimum is None:
            return f"no optimum: {self.reason}"
        if self.optimum.hits == 1:
            return "one start alone led to the optimum; other seeds may find a better one"
        return ""


def solve_references(
    task: Task,
    percepts: Space[Any],
    prices: Sequence[Prices],
    seed: int,
    restarts: int = 32,
    certify: float | None = None,
    beta_direct: float | None = None,
) -> dict[Prices, Reference]:
    """Optimum and bound at each pair of prices.

    Where p(ξ|ω) is estimated (see `bra.tasks.signals`), the error is by how much J changes with
    half as many draws, plus by how much with half as many cells along each number of a signal,
    plus two standard errors of J over the draws. Of a grid it is by how much J changes from the one
    before, see `bra.blahut_arimoto.discretised`.

    Args:
        task: What the agent does.
        percepts: Its percept space.
        prices: Pairs (β₁, β₂), solved as one batch.
        seed: Of the starts, and of signals that are drawn.
        restarts: Starts in a batch for each pair.
        certify: Seconds to spend on lowering the bound of a single pair, as in `serial`.
        beta_direct: β₃, where actions look at the signal again.
    """
    if certify is not None and beta_direct is not None:
        raise ValueError("certify proves optima without beta_direct, got both; leave one out")
    if not isinstance(task, FiniteTask):
        return {pair: _on_grids(task, percepts, pair, seed, restarts) for pair in prices}
    if not isinstance(percepts, Discrete):
        reason = f"percepts {percepts} are not finitely many"
        return {pair: Reference(None, _upper_bound(task, pair), reason=reason) for pair in prices}

    solve = partial(_solve, int(percepts.n), prices, beta_direct, restarts, seed)
    optima = solve(task.utilities, task.prior, seconds=certify if task.noiseless else None)
    plain = [Reference(best, float(best.upper_bound)) for best in optima]
    if task.noiseless:
        return dict(zip(prices, plain, strict=True))
    try:
        tables = signal_tables(task, seed)
    except UnknownSensorError as error:
        hidden = [_without_noise(reference, str(error)) for reference in plain]
        return dict(zip(prices, hidden, strict=True))
    seconds = [certify] + [None] * (len(tables) - 1)
    best, *rougher = (
        solve(*t.problem(task), restarts if t.draws else None, spent)
        for t, spent in zip(tables, seconds, strict=True)
    )
    pairs = enumerate(zip(prices, plain, strict=True))
    return {
        pair: _attainable(
            task, tables[0], pair, best[i], [other[i] for other in rougher], known, beta_direct
        )
        for i, (pair, known) in pairs
    }


def _solve(
    percepts: int,
    prices: Sequence[Prices],
    beta_direct: float | None,
    restarts: int,
    seed: int,
    utilities: Tensor,
    prior: Tensor,
    budget: int | None = None,
    seconds: float | None = None,
) -> list[Serial]:
    """The optima of one table at all pairs of prices."""
    beta_1, beta_2 = torch.tensor(prices, dtype=torch.double).T
    effort = (restarts, seed, budget)
    found: Serial
    if beta_direct is None:
        found = serial(utilities, prior, percepts, beta_1, beta_2, *effort, seconds)
    else:
        found = general(utilities, prior, percepts, beta_1, beta_2, beta_direct, *effort)
    return [_entry(found, index) for index in range(len(prices))]


def _on_grids(
    task: Task, percepts: Space[Any], prices: Prices, seed: int, restarts: int
) -> Reference:
    """The optimum of continuous states or actions, where a task says how to put them on a grid."""

    def problem(points: int) -> tuple[Tensor, Tensor]:
        table = task.grid(points)
        assert table is not None  # as for the fewest points
        return table

    if task.grid(2) is None:
        return Reference(reason=f"{type(task).__name__} has no table of utilities, and no grid")
    count = int(percepts.n) if isinstance(percepts, Discrete) else None
    found = discretised(problem, count, *prices, restarts, seed)
    return Reference(found.optimum, None, found.error)


def _attainable(
    task: FiniteTask,
    table: SignalTable,
    prices: Prices,
    found: Serial,
    rougher: list[Serial],
    without_noise: Reference,
    beta_direct: float | None,
) -> Reference:
    """The optimum over signals, told in states."""
    error = 2 * _standard_error(task, table, found, *prices, beta_direct)
    error += sum(abs(float(found.objective - other.objective)) for other in rougher)
    percept_given_state = table.signal_given_state @ found.percept_given_state
    action_given_state = table.signal_given_state @ found.action_given_state
    optimum = replace(
        found,
        percept_given_state=percept_given_state,
        action_given_state=action_given_state,
        **_looks(table, found),
        end_to_end_information=mutual_information(task.prior, action_given_state).item(),
    )
    assert without_noise.upper_bound is not None  # it has an optimum
    bound = min(float(found.upper_bound) + error, without_noise.upper_bound)
    return Reference(optimum, bound, error, without_noise.optimum)


def _looks(table: SignalTable, found: Serial) -> dict[str, Tensor]:
    """p(a|x,ω) of actions that look at the signal again, of which the solution has p(a|x,s)."""
    if not isinstance(found, General):
        return {}
    percept = found.percept_given_state.clamp(min=TINY)
    pairs = percept.mT.unsqueeze(-1) * found.action_given_percept_and_state
    of_states = table.signal_given_state
    rows = (of_states @ pairs) / (of_states @ percept).mT.unsqueeze(-1)
    return {"action_given_percept_and_state": rows}


def _standard_error(
    task: FiniteTask,
    table: SignalTable,
    found: Serial,
    beta_perception: float,
    beta_action: float,
    beta_direct: float | None,
) -> float:
    """Of J over the draws that p(s|ω) was estimated from; 0 where it is exact.

    J is stationary in the channels, so that its error is that of a mean over signals of
    Σ_x p(x|s) [E_{p(a|x)}[U(ω,a)] − KL(p(a|x) ‖ p(a))/β₂] − KL(p(x|s) ‖ p(x))/β₁; where actions
    look again, with E_{p(a|x,s)}[U(ω,a) − (1/β₂) log p(a|x)/p(a)] − KL(p(a|x,s) ‖ p(a|x))/β₃.
    """
    if table.draws is None:
        return 0.0
    action, percept = found.action_given_percept, found.percept_given_state
    spent = kl_divergence(percept, found.percept_marginal) / beta_perception
    if isinstance(found, General) and beta_direct is not None:
        looks = found.action_given_percept_and_state
        ratio = (action.clamp(min=TINY) / found.action_marginal.clamp(min=TINY)).log()
        costs = (looks @ ratio.unsqueeze(-1)).squeeze(-1) / beta_action
        costs = costs + kl_divergence(looks, action.unsqueeze(1)) / beta_direct
        spent = spent + (percept * costs.mT).sum(1)
    else:
        spent = spent + percept @ kl_divergence(action, found.action_marginal) / beta_action
    values = task.payoffs @ found.action_given_state.T - spent
    means = (table.signal_given_state * values).sum(1, keepdim=True)
    variances = (table.signal_given_state * (values - means).square()).sum(1)
    return (task.prior.square() @ variances / table.draws).sqrt().item()


def _without_noise(reference: Reference, reason: str) -> Reference:
    """Of a sensor about whose noise nothing is known: the bound holds, the optimum does not."""
    return Reference(None, reference.upper_bound, 0.0, reference.optimum, reason)


def _upper_bound(task: FiniteTask, prices: Prices) -> float:
    """The bound on J, whatever the percepts.

    By data processing I(Ω;A) ≤ min(I(Ω;X), I(X;A)), so that one channel at
    1/β = 1/β₁ + 1/β₂ does at least as well as the two.
    """
    beta = 1 / sum(1 / beta for beta in prices)
    return float(rate_distortion(task.utilities, task.prior, beta).upper_bound)


def _entry(batch: Serial, index: int) -> Serial:
    """One of a batch of solutions, its scalars Python numbers."""
    values: dict[str, Any] = {}
    for name, value in vars(batch).items():
        entry = torch.as_tensor(value)[index]
        values[name] = entry if entry.ndim else entry.item()
    return type(batch)(**values)
