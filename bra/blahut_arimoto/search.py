"""The best of many climbs: batches of starts, until the best end has been met often enough.

The first batch holds new starts (see `starts`). In those that follow every second one is a move
away from one of the best ends so far (see `moves`). A pair of prices is done when half of its
starts have led to the best end, when that meets the bound, or when the budget is used up. Half,
since the optimum may be met by one start in a hundred where another end is met by ten. With fewer
percepts than states and actions, where percepts have to be shared out and the optimum may be met by
one start in a hundred even where another end is met by all others, half of the budget is used in
any case.
"""

import logging
import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from bra.blahut_arimoto.climb import SILENCE, climb_all
from bra.blahut_arimoto.moves import Draw, moved
from bra.blahut_arimoto.serial_problem import SerialProblem
from bra.blahut_arimoto.starts import starts

_LOG = logging.getLogger(__name__)
_ENOUGH = 0.5
# Ends this close to each other, relative to the regret, are the same.
_SAME = 1e-9
# Different ends from which moves set out.
_ELITE = 8


@dataclass(frozen=True)
class Plan:
    """What is to be searched, for B pairs of prices.

    Attributes:
        problem: With one climb for each pair.
        one_channel: Optimal p(a|ω) of one channel for each, (B, W, A).
        bound: No J is larger, (B,).
        percepts: |X|.
        restarts: Starts in the first batch, and at most in others.
        budget: Starts in all.
        seed: Of all draws.
    """

    problem: SerialProblem
    one_channel: Tensor
    bound: Tensor
    percepts: int
    restarts: int
    budget: int
    seed: int

    def select(self, cells: Tensor) -> "Plan":
        """The same for some of the pairs."""
        return replace(
            self,
            problem=self.problem.select(cells),
            one_channel=self.one_channel[cells],
            bound=self.bound[cells],
        )


class Ends(NamedTuple):
    """Where n climbs ended for each of B pairs of prices, in order, (B, n) each."""

    value: Tensor
    """J; NaN where other pairs have more climbs."""
    fair: Tensor
    """Whether the climb set out from elsewhere than the best end."""
    gap: Tensor
    sweeps: Tensor
    converged: Tensor

    def hits(self, problem: SerialProblem, best: Tensor) -> Tensor:
        """Climbs that led to the best J (B,) without having set out from there, (B,)."""
        level = best - _SAME * problem.regret - 100 * problem.tolerance()
        return ((self.value >= level[:, None]) & self.fair).sum(1)

    def select(self, cells: Tensor) -> "Ends":
        """The same for some of the pairs."""
        return Ends(*(column[cells] for column in self))

    def followed_by(self, more: "Ends") -> "Ends":
        """With further climbs."""
        return Ends(*(torch.cat(columns, 1) for columns in zip(self, more, strict=True)))


class Elite(NamedTuple):
    """The best different ends, the best first."""

    point: Tensor
    """(A + 1, X, B, E)."""
    value: Tensor
    """J, −inf where there are fewer, (B, E)."""


def search(plan: Plan) -> tuple[Tensor, Ends]:
    """The best end for each pair of prices, (A + 1, X, B), and all ends; progress is logged."""
    began = time.monotonic()
    generator = Generator().manual_seed(plan.seed)
    cells = torch.arange(len(plan.bound))
    found: list[tuple[Tensor, Tensor, Ends]] = []
    drawn = plan.restarts
    elite, ends = _climbed(plan, _opening(plan))
    while True:
        done = _done(plan, ends)
        found.append((cells[done], elite.point[:, :, done, 0], ends.select(done)))
        if done.all():
            return _collected(found)
        cells, plan, ends = cells[~done], plan.select(~done), ends.select(~done)
        elite = Elite(elite.point[:, :, ~done], elite.value[~done])
        count = min(plan.restarts, plan.budget - ends.value.shape[1])
        moves = count // 2 if plan.percepts > 1 else 0
        numbers = range(drawn, drawn + count - moves)
        drawn = numbers.stop
        new = starts(plan.problem, plan.one_channel, plan.percepts, numbers, plan.seed)
        source = torch.arange(moves) % elite.value.isfinite().sum(1, keepdim=True)
        points = torch.cat((new, _moves(plan, elite, source, generator)), 3)
        elite, more = _climbed(plan, points, elite)
        fair = pad(source > 0, (len(numbers), 0), value=True)
        ends = ends.followed_by(more._replace(fair=fair))
        if time.monotonic() - began > SILENCE:
            counts = ends.value.shape[1], plan.budget
            _LOG.info("%s: %d of at most %d starts", plan.problem.solver, *counts)


def _collected(found: list[tuple[Tensor, Tensor, Ends]]) -> tuple[Tensor, Ends]:
    """Points and ends of some pairs of prices after the other, in the order of the pairs."""
    cells, points, parts = zip(*found, strict=True)
    order = torch.cat(cells).argsort()
    most = max(part.value.shape[1] for part in parts)
    columns = []
    for blank, *column in zip((torch.nan, False, 0.0, 0, True), *parts, strict=True):
        wide = [pad(rows, (0, most - rows.shape[1]), value=blank) for rows in column]
        columns.append(torch.cat(wide)[order])
    return torch.cat(points, 2)[..., order], Ends(*columns)


def _opening(plan: Plan) -> Tensor:
    """The first starts (A + 1, X, B, n); the best without percepts where it meets the bound."""
    numbers = range(plan.restarts)
    points = starts(plan.problem, plan.one_channel, plan.percepts, numbers, plan.seed)
    free = plan.problem.percept_free()
    certain = free.value >= plan.bound - plan.problem.tolerance()
    rows = free.log_marginal[:, None, :, None]
    points[:-1] = torch.where(certain[:, None], rows, points[:-1])
    return points


def _moves(plan: Plan, elite: Elite, source: Tensor, generator: Generator) -> Tensor:
    """Moves (A + 1, X, B, m) away from the ends of given ranks (B, m)."""
    cells = torch.arange(len(source))[:, None]
    points = elite.point[:, :, cells, source]
    if not source.numel():
        return points
    problem = plan.problem.select(cells.expand_as(source).flatten())
    draw = Draw(generator, len(source))
    return moved(problem, points.flatten(2), draw).view_as(points)


def _climbed(plan: Plan, points: Tensor, elite: Elite | None = None) -> tuple[Elite, Ends]:
    """The ends of climbs from (A + 1, X, B, n), and the best of them and of those before."""
    count = points.shape[3]
    problem = plan.problem.select(torch.arange(len(plan.bound)).repeat_interleave(count))
    point, *columns = climb_all(problem, points.flatten(2))
    value, *rest = (column.view(-1, count) for column in columns)
    ends = Ends(value, torch.ones_like(value, dtype=torch.bool), *rest)
    point = point.view_as(points)
    if elite is not None:
        point, value = torch.cat((elite.point, point), 3), torch.cat((elite.value, value), 1)
    return _elite(plan.problem, point, value), ends


def _elite(problem: SerialProblem, point: Tensor, value: Tensor) -> Elite:
    """The best different ones of points (A + 1, X, B, n), the first among equals."""
    # Rounding does not choose between names of percepts.
    grain = 100 * problem.tolerance()[:, None]
    order = (value / grain).floor().argsort(dim=1, descending=True, stable=True)
    value = value.gather(1, order)
    same = value[:, :-1] - value[:, 1:] <= _SAME * problem.regret[:, None] + grain
    value[:, 1:] = value[:, 1:].masked_fill(same, -torch.inf)
    value, rank = value.sort(dim=1, descending=True, stable=True)
    chosen = order.gather(1, rank[:, :_ELITE])
    return Elite(point[:, :, torch.arange(len(chosen))[:, None], chosen], value[:, :_ELITE])


def _done(plan: Plan, ends: Ends) -> Tensor:
    """Pairs of prices for which no more starts are needed or allowed, (B,)."""
    best = ends.value.amax(1)
    scarce = plan.percepts < min(plan.problem.utilities.shape)
    least = plan.budget // 2 if scarce else 0
    made = ends.value.shape[1]
    enough = (ends.hits(plan.problem, best) >= _ENOUGH * ends.fair.sum(1)) & (made >= least)
    certain = best >= plan.bound - plan.problem.tolerance()
    return enough | certain | (made >= plan.budget)
