"""A bound on J of two channels in series that closes: branch and bound over action marginals.

**The problem.** For posteriors μ with mean p₀, the prior, and an action marginal q let

    f_q(μ) = −KL(μ ‖ p₀)/β₁ + (1/β₂) log Σ_a q(a) e^{β₂ U_a·μ}.

Since I(X;A) = min_q E KL(p(a|x) ‖ q), the best action channel is worth the last term, and
J* ≤ max_q cav f_q(p₀), cav being the concave envelope; with |X| ≥ |Ω| the two are equal
(Carathéodory). With q the mean of p(a|x) the objective is a concave function of q, by the joint
distributions of percepts and actions that have this mean, minus H(q)/β₂: the only term that is not
concave is a sum over actions.

**Boxes.** Let l ≤ q ≤ u. There −q_a log q_a lies above its secant between l_a and u_a, and with the
secants in its place J is bounded: `relaxed_boxes` says how.

**Symmetry.** If exchanging two actions, and some states, leaves the problem as it is, J is the same
after it, and this holds for all orders of a class of such actions: q may be assumed to fall within.

**Rounding.** A bound is a sum of at most W + A + 16 products, of which the largest is less than the
span of the utilities or 1 500 (1/β₁ + 1/β₂), each known to a few ε: what that adds up to is added.
Large regrets are cut and small prices raised before, both of which only add to J.

Boxes with the largest bound are halved first, so that the largest bound left can only fall, and
holds whenever one stops.
"""

import heapq
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import NamedTuple

import numpy as np

from bra.blahut_arimoto.action_boxes import interchangeable, secant, secant_loss
from bra.blahut_arimoto.concave_envelope import Floats, Integers
from bra.blahut_arimoto.reduction import Reduction
from bra.blahut_arimoto.relaxed_boxes import Box, Relaxation

CLOSED = 5e-4
"""A gap as small as that, relative to the regret B (see `reduction`), is closed."""

_LOG = logging.getLogger(__name__)
# Seconds between two lines of progress.
_SILENCE = 5.0
# Boxes that are halved together, and numbers in one table of theirs.
_TOGETHER, _ROOM = 64, 2**18
# Sweeps for the multipliers of the first box, and of those that begin where a larger one ended.
_FIRST_SWEEPS, _SWEEPS = 400, 60
# In units of B + 1/β₁ + 1/β₂: regrets beyond are cut. In units of 1/B: range of the prices.
_CUT, _LOWEST, _HIGHEST = 1e4, 1e-4, 1e8
# That a box has at least.
_WIDTH = 1e-12
_EPSILON = float(np.finfo(np.float64).eps)


class Certificate(NamedTuple):
    """What branch and bound has proved."""

    bound: float
    """No J is larger."""
    nodes: int
    """Boxes that were bounded."""


class _Open(NamedTuple):
    """A box on the heap: the largest bound first, and of equal ones the largest value."""

    minus_bound: float
    minus_value: float
    number: int
    box: Box
    cover: Integers


@dataclass
class _Search:
    """Branch and bound over boxes of one problem."""

    relaxation: Relaxation
    best: float  # J that is known to be attained
    closed: float  # gap at which a box is closed
    deadline: float
    classes: list[list[int]]
    heap: list[_Open] = field(default_factory=list)
    number: Iterator[int] = field(default_factory=count)
    nodes: int = 0

    def __post_init__(self) -> None:
        self.settled = self.best  # the largest bound of a box that is closed

    @property
    def top(self) -> float:
        """No J is larger, but for rounding."""
        return max(self.settled, -self.heap[0].minus_bound) if self.heap else self.settled

    def begin(self, bound: float) -> None:
        """The box of all marginals, which is known to have a bound."""
        actions = self.relaxation.utilities.shape[1]
        ends = self._tightened(np.zeros(actions), np.ones(actions))
        box = self.relaxation.first(*ends)
        self._add([_Open(-bound, 0.0, 0, box, self.relaxation.covers.simplex)], _FIRST_SWEEPS)

    def round(self) -> None:
        """Halves the boxes with the largest bounds."""
        halves: list[_Open] = []
        room = self.relaxation.utilities.shape[0] * self.heap[0].box.response.size
        together = max(1, min(_TOGETHER, _ROOM // room))
        while self.heap and len(halves) < 2 * together:
            whole = heapq.heappop(self.heap)
            halves += [whole._replace(box=half) for half in self._halves(whole.box)]
        if halves:
            self._add(halves, _SWEEPS)
        covers = self.relaxation.covers
        if covers.crowded:
            kept = covers.forget([part.cover for part in self.heap])
            pairs = zip(self.heap, kept, strict=True)
            self.heap = [part._replace(cover=cover) for part, cover in pairs]

    def _halves(self, box: Box) -> Iterator[Box]:
        """Both parts of a box, without marginals that cannot be or need not be considered.

        The box is cut where the secant is furthest off, mostly at the optimum, and near it.
        """
        loss = secant_loss(box.low, box.high, np.clip(box.marginal, box.low, box.high))
        slope, _ = secant(box.low, box.high)
        worst = np.clip(np.exp(-1 - slope), box.low, box.high)
        action = (loss + 0.1 * secant_loss(box.low, box.high, worst)).argmax()
        low, high = box.low[action], box.high[action]
        width = high - low
        near = (box.marginal[action] + low + 0.45 * width) / 2
        cut = np.clip(near, low + 0.2 * width, high - 0.2 * width)
        for ends in ((low, cut), (cut, high)):
            part_low, part_high = box.low.copy(), box.high.copy()
            part_low[action], part_high[action] = ends
            part_low, part_high = self._tightened(part_low, part_high)
            if (part_low <= part_high + _WIDTH).all() and part_low.sum() <= 1 + _WIDTH:
                yield box._replace(low=part_low, high=np.maximum(part_high, part_low + _WIDTH))

    def _tightened(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """The smallest box with the same marginals that sum to one and fall within classes."""
        for _ in range(2):
            for members in self.classes:
                low[members] = np.maximum.accumulate(low[members][::-1])[::-1]
                high[members] = np.minimum.accumulate(high[members])
            high = np.minimum(high, 1 - (low.sum() - low))
            low = np.maximum(low, 1 - (high.sum() - high))
        return low, high

    def _add(self, parts: list[_Open], sweeps: int) -> None:
        """Bounds boxes that are known to have bounds, and remembers them while they are open."""
        self.nodes += len(parts)
        found = self.relaxation.bounded(
            Box.stacked([part.box for part in parts]),
            [part.cover for part in parts],
            np.array([-part.minus_bound for part in parts]),
            self.best,
            self.closed,
            sweeps,
            self.deadline,
        )
        rows = zip(
            found.bound, found.value, zip(*found.boxes, strict=True), found.covers, strict=True
        )
        for bound, value, box, cover in rows:
            if bound <= self.best + self.closed:
                self.settled = max(self.settled, float(bound))
            else:
                place = -float(bound), -float(value), next(self.number)
                heapq.heappush(self.heap, _Open(*place, Box(*box), cover))


def certify_gap(
    problem: Reduction, best: float, bound: float, seconds: float, nodes: int | None = None
) -> Certificate:
    """Branch and bound until the gap is closed, or the seconds are over.

    Args:
        problem: At one pair of prices.
        best: J that is known to be attained, in `unit`s.
        bound: No J is larger, in `unit`s.
        seconds: Time to spend.
        nodes: Boxes after which to stop; None for any number.

    Returns:
        A bound that is no larger, in `unit`s.
    """
    began = time.monotonic()
    regret, (beta_1, beta_2) = float(problem.regret), (float(beta) for beta in problem.prices)
    closed = CLOSED * regret
    if bound - best <= closed or max(beta_1, beta_2) * regret > _HIGHEST:
        return Certificate(bound, 0)
    beta_1, beta_2 = (max(beta, _LOWEST / regret) for beta in (beta_1, beta_2))
    occurs = problem.prior > 0
    cut = _CUT * (regret + 1 / beta_1 + 1 / beta_2)
    utilities = problem.utilities[occurs].clamp(min=-cut).numpy()
    prior = problem.prior[occurs].numpy()
    classes, deadline = interchangeable(utilities, prior), began + seconds
    relaxation = Relaxation(utilities, prior, beta_1, beta_2)
    search = _Search(relaxation, best, closed, deadline, classes)
    search.begin(bound)
    said = began
    while search.top > best + closed:
        if time.monotonic() > deadline or (nodes is not None and search.nodes >= nodes):
            break
        search.round()
        if time.monotonic() - said > _SILENCE:
            said = time.monotonic()
            gap = problem.unit * (search.top - best)
            _LOG.info("certify: gap %.2g after %d boxes, %.0f s", gap, search.nodes, said - began)
    slack = 16 * _EPSILON * (sum(utilities.shape) + 16)
    slack *= float(np.ptp(utilities)) + 1500 * (1 / beta_1 + 1 / beta_2)
    return Certificate(min(bound, search.top + slack), search.nodes)
