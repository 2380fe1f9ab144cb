"""Split and merge: new starts out of the ends of climbs.

A local optimum of the serial problem has two percepts where one would do, and one where two are
needed. A move merges the two percepts with the most similar responses, and spends the percept it
gains on splitting another one in two; both are drawn, the better ones more often.
"""

import torch
from torch import Generator, Tensor

from bra.blahut_arimoto.serial_problem import SerialProblem

_TINY = 1e-12
# Marginals below this would keep a split from using other actions.
_ACTION_SHARE = 1e-3


class Draw:
    """Draws of an index for each of N climbs, the same ones for every pair of prices.

    Args:
        generator: Where they come from.
        pairs: Pairs of prices, among which the climbs are divided in order.
    """

    def __init__(self, generator: Generator, pairs: int) -> None:
        self._generator, self._pairs = generator, pairs

    def __call__(self, weights: Tensor) -> Tensor:
        """An index (N,) with the probability of its weight (K, N)."""
        kinds, climbs = weights.shape
        shape = (kinds, climbs // self._pairs)
        noise = torch.rand(shape, generator=self._generator, dtype=weights.dtype)
        return (noise.log().repeat(1, self._pairs) / weights.clamp(min=_TINY**2)).argmax(0)


def moved(problem: SerialProblem, point: Tensor, draw: Draw) -> Tensor:
    """One move away from every point (A + 1, X, N), |X| ≥ 2.

    Args:
        problem: The problem of the climbs that ended there.
        point: Where they ended.
        draw: Of percepts and states.
    """
    each = torch.arange(point.shape[2])
    joint = problem.prior[:, None, None] * problem.perceive(point).percept_given_state
    percept = joint.sum(0)
    kept, freed = _pair_to_merge(point[:-1].exp(), percept, draw)
    donor = _percept_to_split(problem, joint, freed, draw)
    part, rest = _halves(problem, joint[:, donor, each], draw)

    marginal = (percept * point[:-1].exp()).sum(1).clamp(min=_ACTION_SHARE)
    new, share = point.clone(), percept.clamp(min=_TINY)
    share[kept, each] += percept[freed, each]
    for slot, states in ((freed, part), (donor, rest)):
        rows = problem.respond(marginal.log()[:, None], states[:, None])
        new[:-1, slot, each] = rows.squeeze(1)
        share[slot, each] = states.sum(0).clamp(min=_TINY)
    new[-1] = share.log().log_softmax(0)
    return new


def _pair_to_merge(action: Tensor, percept: Tensor, draw: Draw) -> tuple[Tensor, Tensor]:
    """Two percepts (N,) each, of p(a|x) (A, X, N) and p(x) (X, N), cheap mergers more often."""
    percepts = len(percept)
    root = action.sqrt()
    distance = (root[:, :, None] - root[:, None]).square().sum(0)
    cost = distance * percept[:, None] * percept / (percept[:, None] + percept).clamp(min=_TINY)
    cost = cost.flatten(0, 1)
    cost[:: percepts + 1] = torch.inf
    typical = cost.sort(0).values[percepts] + _TINY
    pair = draw((-cost / typical).exp())
    return pair // percepts, pair % percepts


def _percept_to_split(problem: SerialProblem, joint: Tensor, freed: Tensor, draw: Draw) -> Tensor:
    """A percept (N,), more often one whose states (W, X, N) want different actions."""
    together = torch.einsum("wxn,wa->axn", joint, problem.utilities).amax(0)
    loss = (joint * problem.utilities.amax(1)[:, None, None]).sum(0) - together
    loss[freed, torch.arange(len(freed))] = 0
    return draw(loss.clamp(min=0))


def _halves(problem: SerialProblem, states: Tensor, draw: Draw) -> tuple[Tensor, Tensor]:
    """p(ω,x) (W, N) in two parts, by which of two of the states' utilities are closer."""
    distance = torch.cdist(problem.utilities, problem.utilities)
    first = draw(states)
    second = draw(states * distance[:, first].square())
    nearer = distance[:, first] < distance[:, second]
    return states * nearer, states * ~nearer
