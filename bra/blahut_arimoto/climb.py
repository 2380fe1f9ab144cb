"""Climbs of the serial problem: sweeps, lengthened by squared extrapolation (SQUAREM).

Two sweeps from θ₀ give θ₁ and θ₂, the change r = θ₁ − θ₀ and the bend v = θ₂ − θ₁ − r. Varadhan
and Roland (2008) extrapolate to θ₀ + 2t r + t² v, t = |r|/|v|, which is where a linear map with one
rate would end. A third sweep follows from there; if J lies below that of θ₂, θ₂ is kept instead.
"""

import itertools
import logging
import time
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from bra.blahut_arimoto.serial_problem import SerialProblem, Sweep

SWEEP_CAP = 10_000

# Seconds of climbing after which progress is logged: of climbs that are done, of those that climb.
SILENCE, _LONG_SILENCE = 5.0, 20.0

_LOG = logging.getLogger(__name__)

# Where J is flat, t points far beyond where it rises. Its limit starts here, grows as long as
# steps that reach it pay, and shrinks when they do not.
_FIRST_LIMIT = 64.0
# Cycles of three sweeps from one renewal of the marginals by Newton steps to the next.
_RENEWAL = 20
# Numbers in one table of the climbs that run together, of which some twenty are held.
_ROOM = 2**21
# Regrets 10⁸ times what an optimum can lose are penalties, 10² times is what they begin with; in a
# state of p(ω) < 10⁻² both are in proportion to 1/p(ω), as long as it may bear them in every case.
_SOFT, _PENALTY = 1e2, 1e6
# What excludes an action, added to the logarithm of its probability.
_NEVER = -1e4
_TINY = torch.finfo(torch.float32).tiny
# Tables of so many states, actions and percepts, by product, are swept in float32 at first, but not
# beyond a renewal, and if logarithms of probabilities keep some digits.
_LARGE, _ROUGH_SWEEPS, _STEEPEST = 10**6, 3 * _RENEWAL - 3, 1e3


class Climb(NamedTuple):
    """Where N climbs ended."""

    point: Tensor  # (A + 1, X, N)
    value: Tensor  # J, (N,)
    gap: Tensor  # (N,)
    sweeps: Tensor  # (N,)
    converged: Tensor  # (N,)


def climb_all(problem: SerialProblem, start: Tensor) -> Climb:
    """Climbs that run together as far as there is room, and meet large penalties step by step.

    Where they take long, progress is logged.

    A state leaves every percept that may lead, with however small a probability, to what it
    penalises, and climbs end wherever that takes them. So penalties are small at first. Before they
    grow, the less likely one leaves: the action or the state.
    """
    room = max(1, _ROOM // (max(problem.utilities.shape) * start.shape[1]))
    soft = -problem.regret.amax() * (1 / problem.prior[:, None]).clamp(min=_SOFT)
    penalised = problem.utilities < soft
    parts, began = [], time.monotonic()
    for columns in torch.split(torch.arange(start.shape[2]), room):
        part, point = problem.select(columns), start[..., columns]
        if (problem.utilities < _PENALTY * soft).any():
            mild = replace(part, utilities=part.utilities.maximum(soft))
            point = _without_penalties(mild, climb(mild, point, SWEEP_CAP).point, penalised)
        parts.append(_climb_roughly_first(part, point))
        if time.monotonic() - began > SILENCE:
            done = int(columns[-1]) + 1
            counts = done, start.shape[2]
            _LOG.info("%s: %d of %d climbs of this batch are done", problem.solver, *counts)
    return Climb(*(torch.cat(rows, -1) for rows in zip(*parts, strict=True)))


def _without_penalties(problem: SerialProblem, point: Tensor, penalised: Tensor) -> Tensor:
    """The point without actions penalised (W, A) by a state that has more of the percept."""
    joint = problem.prior[:, None, None] * problem.perceive(point).percept_given_state
    log_action, percept = point[:-1], joint.sum(0)
    taken = percept * log_action.exp()
    claims = torch.stack([(joint * state[:, None, None]).amax(0) for state in penalised.T.double()])
    rows = torch.where(claims > taken, log_action + _NEVER, log_action).log_softmax(0)
    return torch.cat((rows, percept.clamp(min=_TINY).log()[None]))


def _climb_roughly_first(problem: SerialProblem, start: Tensor) -> Climb:
    """`climb`, of which large problems begin in float32, at half the cost."""
    steepness = -problem.utilities.amin() * torch.maximum(problem.beta_1, problem.beta_2).amax()
    large = problem.utilities.numel() * start.shape[1] >= _LARGE
    if not (large and problem.single_precision and steepness <= _STEEPEST):
        return climb(problem, start, SWEEP_CAP)
    rough = climb(problem.single(), start.float(), _ROUGH_SWEEPS)
    end = climb(problem, rough.point.double(), SWEEP_CAP)
    return end._replace(sweeps=rough.sweeps + end.sweeps)


def climb(problem: SerialProblem, start: Tensor, cap: int) -> Climb:
    """Run every climb of the batch until its certificate meets the tolerance, or to the cap."""
    point, count = start, start.shape[2]
    end = Climb(
        point=torch.empty_like(start),
        value=start.new_empty(count),
        gap=start.new_empty(count),
        sweeps=torch.empty(count, dtype=torch.int64),
        converged=torch.empty(count, dtype=torch.bool),
    )
    tolerance = problem.tolerance()
    limit = start.new_full((count,), _FIRST_LIMIT)
    running, said = torch.arange(count), time.monotonic()
    for cycle in itertools.count(1):
        first = problem.sweep(point)
        second = problem.sweep(first.point)
        gap = problem.gap(first, second)
        converged = gap <= tolerance
        leaving = converged | (3 * cycle >= cap)
        left = leaving.nonzero().squeeze(1)
        if len(left):
            sweeps = torch.full_like(running, 3 * cycle - 1)
            rows = Climb(first.point, problem.objective(second), gap, sweeps, converged)
            for total, part in zip(end, rows, strict=True):
                total[..., running[left]] = part[..., left]
            if len(left) == len(running):
                break
        if time.monotonic() - said > _LONG_SILENCE:
            said = time.monotonic()
            _LOG.info("%s: gap %.1e after %d sweeps", problem.solver, gap.amax(), 3 * cycle - 1)
        if cycle % _RENEWAL:
            point, limit = _leap(problem, point, first, second, limit)
        else:
            point = _renewed(problem, second, gap, tolerance)
        if len(left):
            stay = (~leaving).nonzero().squeeze(1)
            problem, point = problem.select(stay), point[..., stay]
            running, limit, tolerance = running[stay], limit[stay], tolerance[stay]
    return end


def _renewed(problem: SerialProblem, last: Sweep, gap: Tensor, tolerance: Tensor) -> Tensor:
    """Where Newton steps lead, but for climbs of which they undo what sweeps have done.

    They know marginals to a certificate of their own. With a state that hardly ever occurs and is
    worth much, sweeps come closer, and renewals would take them back for ever.
    """
    renewed = problem.renew(last)
    first = problem.sweep(renewed)
    closer = problem.gap(first, problem.sweep(first.point)) < gap
    risen = problem.objective(first) > problem.objective(last) + tolerance
    return torch.where(closer | risen, renewed, last.point)


def _leap(
    problem: SerialProblem, start: Tensor, first: Sweep, second: Sweep, limit: Tensor
) -> tuple[Tensor, Tensor]:
    """Where the climbs go after two sweeps, and their next limits of the step length (N,)."""
    rise = (first.point - start).amax((0, 1)).clamp(min=_TINY)
    bound = torch.minimum(limit, problem.reach / rise)
    candidate, length = _extrapolate(start, first.point, second.point, bound)
    third = problem.sweep(candidate)
    risen = problem.objective(third) >= problem.objective(second)
    reached = torch.where(length >= limit, 4 * limit, limit)
    limit = torch.where(risen, reached, (limit / 2).clamp(min=2.0))
    return torch.where(risen, third.point, second.point), limit


def _extrapolate(
    start: Tensor, first: Tensor, second: Tensor, limit: Tensor
) -> tuple[Tensor, Tensor]:
    """The point that two sweeps seem to lead to, and the step length (N,).

    Lengths are in the Fisher metric Σ p(x) [(δ log p(x))² + Σ p(a|x) (δ log p(a|x))²]: what hardly
    ever happens should not set the step.
    """
    change = first - start
    bend = (second - first).sub_(change)
    weight = first.exp()
    weight[:-1] *= weight[-1]
    bent = (weight * bend).mul_(bend).sum((0, 1)).clamp(min=_TINY)
    length = (weight.mul_(change).mul_(change).sum((0, 1)) / bent).sqrt().clamp(min=1.0)
    t = torch.minimum(length, limit)
    point = torch.addcmul(start, 2 * t, change).addcmul_(t * t, bend)
    return torch.cat((point[:-1].log_softmax(0), point[-1:].log_softmax(1))), t
