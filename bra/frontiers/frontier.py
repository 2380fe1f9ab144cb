"""Optima along prices, and the prices at which their behaviour changes."""

import itertools
import math
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor

from bra.blahut_arimoto import Serial, general, serial
from bra.checks.memory import check_memory
from bra.checks.prices import check_beta
from bra.checks.settings import check_count, check_flag, check_kind
from bra.frontiers.optima import Optima
from bra.objective import bits
from bra.tasks import FiniteTask

WORTHLESS, SATURATED = 1e-6, 1e-3
"""Nats that count as none, per probability of the rarest state; share of what information can earn
at which a curve ends."""
DEAR, FORCED, CHEAP = 1e-4, 1.0, 1e8
"""Between which prices a curve is looked for: from the first per range of the utilities, the second
where no action is allowed in all states, to the third per utility that information can earn."""
CLOSE = 2e-3
"""Share of a price up to which a change is located; climbs take ever longer the closer they are."""
LOCATED = 12
"""Changes that are located at most."""
BEGINNING = "information becomes worth its price: {} percepts"
SPECIALISTS = "percepts become worth their price: {} percepts"


@dataclass(frozen=True)
class Frontier:
    """The optima of a task at N pairs of prices, in the order of the prices.

    Along a curve each change of behaviour has two rows, the optimum just below the price and the
    one just above it, which says what changed.

    Attributes:
        beta_perception: β₁, (N,), per nat.
        beta_action: β₂, (N,), per nat.
        objective: J of the best channels found, (N,).
        expected_utility: E[U], (N,).
        utility_bound: What no channels with the same I(Ω;X) and I(X;A) exceed, (N,): since
            J ≤ B at every pair of prices, E[U] ≤ B + I(Ω;X)/β₁ + I(X;A)/β₂ at each of them, of
            which this is the least; with I(Ω;A|X)/β₃ where actions look again.
        perception_information: I(Ω;X) in nats, (N,).
        action_information: I(X;A) in nats, (N,).
        end_to_end_information: I(Ω;A) in nats, (N,).
        upper_bound: What no channels exceed in J, (N,).
        percepts: Percepts that are used and differ in p(a|x), (N,).
        change: What changes at this price; empty elsewhere, N texts.
        beta_direct: β₃, (N,), per nat, where actions look at the state again, else None.
        direct_information: I(Ω;A|X) in nats, (N,), else None.
    """

    beta_perception: Tensor
    beta_action: Tensor
    objective: Tensor
    expected_utility: Tensor
    utility_bound: Tensor
    perception_information: Tensor
    action_information: Tensor
    end_to_end_information: Tensor
    upper_bound: Tensor
    percepts: Tensor
    change: tuple[str, ...]
    beta_direct: Tensor | None = None
    direct_information: Tensor | None = None

    def rows(self) -> list[dict[str, Any]]:
        """A row per optimum; informations in nats and in bits."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        known = {name: column for name, column in columns.items() if column is not None}
        return tidy_rows("optimum", known)

    def to_pandas(self) -> Any:
        """The rows as a `pandas.DataFrame`.

        Raises:
            ImportError: If pandas is not installed.
        """
        from pandas import DataFrame  # type: ignore[import-untyped, unused-ignore]

        return DataFrame(self.rows())


def tidy_rows(kind: str, columns: Mapping[str, Tensor | Sequence[Any]]) -> list[dict[str, Any]]:
    """Columns as rows that say what they are, informations in nats and in bits."""
    named: dict[str, Sequence[Any]] = {}
    for name, values in columns.items():
        listed = values.tolist() if isinstance(values, Tensor) else values
        if name.endswith("information"):
            named |= {f"{name}_nats": listed, f"{name}_bits": [bits(value) for value in listed]}
        else:
            named[name] = listed
    rows = zip(*named.values(), strict=True)
    return [{"kind": kind} | dict(zip(named, row, strict=True)) for row in rows]


def frontier(
    task: FiniteTask,
    beta_perception: float = 1.0,
    beta_action: float = 1.0,
    percepts: int | None = None,
    points: int = 40,
    grid: bool = False,
    restarts: int = 32,
    seed: int = 0,
    beta_direct: float | None = None,
) -> Frontier:
    """What the optimal agent earns, and how much information it takes, from dear to cheap.

    All prices are scaled together, from a little below those at which information first becomes
    worth its price to those at which it earns all but a thousandth of what it can. The prices at
    which information becomes worth it, and at which percepts come or go, are found by bisection, to
    two thousandths of the price: the first dozen; others are told where the curve has a point. The
    optima are the best of many starts; the bounds are certified.

    Args:
        task: Utilities and prior.
        beta_perception: β₁ up to a common factor.
        beta_action: β₂ up to the same factor.
        percepts: |X|; the number of states, with which more never help, if None.
        points: Pairs of prices on the curve, at equal ratios; those of changes come on top.
        grid: Whether each of so many β₁ meets each of so many β₂, β₃ staying what it is.
        restarts: Starts of the solver for each pair.
        seed: Of the starts.
        beta_direct: β₃ up to the same factor, where actions look at the state again.

    Returns:
        N optima: about `points`, or `points` squared of a grid with β₁ as the slower one.

    Raises:
        ValueError: If a number is not admissible, or one action is best in every state, so that
            information is never worth anything.
    """
    check_kind(task, FiniteTask, "task")
    grid, points = check_flag(grid, "grid"), check_count(points, "points")
    check_memory(8 * len(task.prior) * points ** (1 + grid), f"points {points:,}")
    percepts = len(task.prior) if percepts is None else check_count(percepts, "percepts")
    ratio, looks = _ratio(beta_perception, beta_action, beta_direct), beta_direct is not None

    def solve(prices: Tensor, budget: int | None = None) -> Optima:
        solver: Callable[..., Serial] = general if looks else serial
        found = solver(task.utilities, task.prior, percepts, *prices, restarts, seed, budget)
        return Optima.of(prices, found, task.prior)

    def locate(prices: Tensor) -> Optima:
        """Once: where a change is continuous, climbs are slow, and no better end is to be found."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "(serial|general): .*did not converge")
            return solve(prices, restarts)

    ends = _ends(solve(ratio[:, None] * _looked_through(task)), WORTHLESS * task.prior.amin())
    scales = torch.logspace(*ends, points, dtype=torch.double) / ratio[0]
    if grid:
        return _frontier(solve(ratio[:, None] * _all_pairs(scales, len(ratio))), [""] * points**2)
    curve = solve(ratio[:, None] * scales).improved().with_changes(locate, 1 + CLOSE, LOCATED)
    return _frontier(curve, _changes(curve.percepts.tolist(), SPECIALISTS if looks else BEGINNING))


def _ratio(beta_perception: float, beta_action: float, beta_direct: float | None) -> Tensor:
    """The prices to be scaled, (2,) or (3,), float64."""
    given = [
        check_beta(beta_perception, "beta_perception"),
        check_beta(beta_action, "beta_action", infinite=beta_direct is not None),
    ]
    if beta_direct is not None:
        given.append(check_beta(beta_direct, "beta_direct"))
    return torch.tensor(given, dtype=torch.double)


def _all_pairs(scales: Tensor, prices: int) -> Tensor:
    """Each scale of β₁ with each of β₂, and β₃, if there is one, as it is, (prices, n²)."""
    pairs = torch.cartesian_prod(scales, scales).T
    return torch.cat([pairs, pairs.new_ones(prices - 2, len(scales) ** 2)])


def _looked_through(task: FiniteTask) -> Tensor:
    """Scales of prices, four a decade."""
    least, most = task.utilities.amax(1), (task.prior @ task.utilities).amax()
    earned = (task.prior @ least - most).item()
    if earned <= sys.float_info.epsilon * task.utility_range:
        raise ValueError(
            "one action is best in every state, so that information earns nothing; a frontier "
            "needs a task with a choice to make"
        )
    free = earned < math.inf
    start = math.log10((DEAR if free else FORCED) / task.utility_range)
    end = math.log10(CHEAP / (earned if free else task.utility_range))
    return torch.logspace(start, end, round(4 * (end - start)) + 1, dtype=torch.double)


def _ends(coarse: Optima, worthless: Tensor) -> tuple[float, float]:
    """log₁₀ of the prices β₁ between which information goes from nothing to all it can earn."""
    informed = coarse.end_to_end_information > worthless
    if not informed.any():
        raise ValueError(
            "no price makes information worth it; a frontier needs two percepts or more"
        )
    first = max(int(informed.long().argmax()) - 1, 0)
    least, most = coarse.expected_utility.aminmax()
    saturated = coarse.expected_utility >= most - SATURATED * (most - least)
    last = max(int(saturated.long().argmax()), first + 4)
    start, end = coarse.prices[0, [first, last]].log10().tolist()
    return start, end


def _changes(counts: Sequence[int], beginning: str) -> list[str]:
    """What changes from the point before to each point."""
    texts = [""]
    for before, after in itertools.pairwise(counts):
        change = f"{before} → {after} percepts" if before > 1 else beginning.format(after)
        texts.append("" if before == after else change)
    return texts


def _frontier(optima: Optima, change: list[str]) -> Frontier:
    direct = [part for rows in (optima.prices, optima.informations) for part in rows[2:]]
    return Frontier(
        beta_perception=optima.prices[0],
        beta_action=optima.prices[1],
        objective=optima.objective,
        expected_utility=optima.expected_utility,
        utility_bound=(optima.bound[:, None] + optima.costs()).amin(0),
        perception_information=optima.informations[0],
        action_information=optima.informations[1],
        end_to_end_information=optima.end_to_end_information,
        upper_bound=optima.bound,
        percepts=optima.percepts,
        change=tuple(change),
        **dict(zip(("beta_direct", "direct_information"), direct, strict=False)),
    )
