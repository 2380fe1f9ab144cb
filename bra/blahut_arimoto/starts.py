"""Where the climbs of the serial problem start: action channels p(a|x), percepts equally likely.

The first is the diagonal start of Genewein et al. (2015), in which each percept stands for its own
share of the states. Then follow, in turn,

* percepts that stand for the actions which the disturbed one-channel optimum uses most,
* percepts that stand for groups of states with similar rows in another disturbed one-channel
  optimum, agglomerated by Ward's method,
* covering starts, in which the percepts share out a random part of the actions,
* perceptions at random, from vague to sharp,
* covering starts that are annealed: swept a few times at higher prices.

Where there are percepts enough, an optimum may still use few of many actions. So the number of
groups is then drawn log-uniformly, as is always the number of actions that annealed starts share.

None of the kinds is best for all utilities and prices; `benchmarks/serial_starts.py` counts.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from bra.blahut_arimoto.serial_problem import SerialProblem

KINDS = ("disturbed", "agglomerated", "covering", "perception", "annealed")
"""Start number n > 0 is of kind (n − 1) mod 5."""

_TINY = torch.finfo(torch.float64).tiny
_ANNEALING, _SWEEPS = (4.0, 2.0), 5


def starts(
    problem: SerialProblem, one_channel: Tensor, percepts: int, numbers: range, seed: int
) -> Tensor:
    """Starting points (A + 1, X, B, len(numbers)): the same draws for every pair of prices.

    Args:
        problem: The problem, with one climb for each of B pairs of prices.
        one_channel: Optimal p(a|ω) of one channel for each of them, (B, W, A).
        percepts: Number of percepts |X|.
        numbers: Which of an endless row of starts.
        seed: Seed of the row.
    """
    kinds, pairs = len(KINDS), len(one_channel)
    points = [_diagonal(problem, percepts)[..., None]] if numbers.start == 0 else []
    rounds = range(max(numbers.start - 1, 0) // kinds, (numbers.stop - 2) // kinds + 1)
    if rounds:
        shape = *problem.utilities.shape, percepts
        drawn = zip(*(_draws([seed % 2**64, number], *shape) for number in rounds), strict=True)
        stacked = _Draws(*(torch.from_numpy(np.stack(draws * pairs)) for draws in drawn))
        each = torch.arange(pairs).repeat_interleave(len(rounds))
        in_turn = _round(problem.select(each), one_channel[each], percepts, stacked)
        row = torch.stack(in_turn, 3).view(-1, percepts, pairs, len(rounds) * kinds)
        skipped = max(numbers.start, 1) - (rounds.start * kinds + 1)
        points.append(row[..., skipped : skipped + len(numbers) - len(points)])
    return torch.cat(points, 3)


class _Draws(NamedTuple):
    """What is drawn for a start of each kind, for each of N climbs."""

    disturbance: Tensor  # logits (N, W, A)
    grouping: Tensor  # logits (N, W, A)
    groups: Tensor  # how many, (N,)
    covering: Tensor  # logits (N, X, A)
    perception: Tensor  # logits (N, W, X)
    annealed: Tensor  # logits (N, X, A)


def _draws(seed: list[int], states: int, actions: int, percepts: int) -> tuple[ArrayLike, ...]:
    """Draws for one start of each kind, a seed of its own for every round."""
    rng = np.random.default_rng(seed)

    def cover(count: float) -> np.ndarray:
        chosen = rng.permutation(actions)[: math.ceil(count)]
        logits = rng.standard_normal((percepts, actions))
        logits[np.arange(percepts), np.resize(chosen, percepts)] += 5
        return logits

    scales = rng.random(6)
    enough = min(states, actions)
    return (
        3 * scales[0] * rng.standard_normal((states, actions)),
        4 * scales[1] * rng.standard_normal((states, actions)),
        percepts if percepts < enough else 1 + math.ceil((enough - 1) ** scales[5]),
        cover(scales[2] * actions),
        10 * scales[3] * rng.standard_normal((states, percepts)),
        cover(actions ** scales[4]),
    )


def _round(
    problem: SerialProblem, one_channel: Tensor, percepts: int, draws: _Draws
) -> tuple[Tensor, ...]:
    """One start of each kind for each of N climbs, (A + 1, X, N) each."""
    log_channel = one_channel.clamp(min=_TINY).log()
    disturbed = (log_channel + draws.disturbance).softmax(2)
    grouped = (log_channel + draws.grouping).softmax(2)
    return (
        _meaning(problem, _most_used(problem, disturbed, percepts)),
        _meaning(problem, agglomerated(grouped, problem.prior, draws.groups, percepts)),
        _point(draws.covering),
        _meaning(problem, draws.perception.softmax(2)),
        _annealed(problem, _point(draws.annealed)),
    )


def _diagonal(problem: SerialProblem, percepts: int) -> Tensor:
    states = len(problem.prior)
    distance = torch.arange(states)[:, None] - torch.arange(percepts)
    return _meaning(problem, (distance % min(states, percepts) == 0).double())


def _most_used(problem: SerialProblem, channel: Tensor, percepts: int) -> Tensor:
    """The columns of the actions that p(a|ω) (B, W, A) uses most as p(x|ω) (B, W, X).

    Percepts beyond the number of actions begin as copies.
    """
    order = (problem.prior @ channel).argsort(dim=1, descending=True, stable=True)
    meaning = order[:, torch.arange(percepts) % order.shape[1]]
    return channel.gather(2, meaning[:, None].expand(-1, channel.shape[1], -1))


def agglomerated(channel: Tensor, prior: Tensor, count: Tensor, percepts: int) -> Tensor:
    """p(x|ω) (B, W, X) by Ward's method: states merged, two at a time, until few groups are left.

    The two groups are merged whose merger adds least to Σ p(ω) ‖√p(a|ω) − mean‖² of the groups, by
    the recurrence of Lance and Williams (1967). A merged group is no nearer to any other than the
    nearer one of its parts was, so that most groups keep their nearest one. Percepts beyond the
    number of groups are copies.

    Args:
        channel: p(a|ω), (B, W, A).
        prior: p(ω), (W,).
        count: Groups that are to be left, (B,), as many as there are states at most.
        percepts: |X|.
    """
    cells, states, _ = channel.shape
    groups = torch.eye(states, dtype=torch.bool).expand(cells, -1, -1).clone()
    weight = prior.expand(cells, -1).clone()
    share = weight[:, :, None] * weight[:, None] / (weight[:, :, None] + weight[:, None])
    cost = share * torch.cdist(channel.sqrt(), channel.sqrt()).square()
    cost.diagonal(dim1=1, dim2=2).fill_(math.inf)
    least, nearest = cost.min(2)
    for merged in range(states - int(count.min())):
        each = (count < states - merged).nonzero().squeeze(1)
        one = least[each].argmin(1)
        other = nearest[each, one]
        heavier, added = weight[each, one, None], weight[each, other, None]
        joined = (heavier + weight[each]) * cost[each, one]
        joined += (added + weight[each]) * cost[each, other]
        joined -= weight[each] * cost[each, one, other, None]
        joined /= heavier + added + weight[each]
        joined[torch.arange(len(each)), one] = math.inf
        cost[each, one], cost[each, :, one] = joined, joined
        cost[each, other], cost[each, :, other] = math.inf, math.inf
        weight[each, one] += weight[each, other]
        groups[each, :, one] |= groups[each, :, other]
        groups[each, :, other] = False
        pair = torch.stack((one, other), 1)[:, None]
        cell, row = (nearest[each, :, None] == pair).any(2).nonzero(as_tuple=True)
        least[each[cell], row], nearest[each[cell], row] = cost[each[cell], row].min(1)
        least[each, other] = math.inf
    left = groups.any(1).double().argsort(dim=1, descending=True, stable=True)
    chosen = left.gather(1, torch.arange(percepts) % count[:, None])
    return groups.gather(2, chosen[:, None].expand(-1, states, -1)).double()


def _annealed(problem: SerialProblem, point: Tensor) -> Tensor:
    for factor in _ANNEALING:
        beta_1, beta_2 = factor * problem.beta_1, factor * problem.beta_2
        hot = replace(problem, beta_1=beta_1, beta_2=beta_2)
        for _ in range(_SWEEPS):
            point = hot.sweep(point).point
    return point


def _meaning(problem: SerialProblem, perception: Tensor) -> Tensor:
    """The point (A + 1, X, B) of the best responses to p(x|ω), (B, W, X) or (W, X)."""
    joint = (problem.prior[:, None] * perception).movedim((-2, -1), (0, 1))
    joint = joint.reshape(*joint.shape[:2], -1).expand(-1, -1, len(problem.beta_2))
    rows = problem.respond(torch.zeros(()).to(joint), joint)
    return _with_even_percepts(rows)


def _point(logits: Tensor) -> Tensor:
    """The point (A + 1, X, B) of action logits (B, X, A) and percepts that are equally likely."""
    return _with_even_percepts(logits.permute(2, 1, 0).log_softmax(0))


def _with_even_percepts(rows: Tensor) -> Tensor:
    return torch.cat((rows, torch.full_like(rows[:1], 1 / rows.shape[1]).log()))
