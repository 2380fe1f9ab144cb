"""A bound on J of two channels in series that closes: branch and bound over action marginals.

**The problem.** For posteriors μ with mean p₀, the prior, and an action marginal q let

    f_q(μ) = −KL(μ ‖ p₀)/β₁ + (1/β₂) log Σ_a q(a) e^{β₂ U_a·μ}.

Since I(X;A) = min_q E KL(p(a|x) ‖ q), the best action channel is worth the last term, and
J* ≤ max_q cav f_q(p₀), cav being the concave envelope; with |X| ≥ |Ω| the two are equal
(Carathéodory). With q the mean of p(a|x) the objective is a concave function of q, by the joint
distributions of percepts and actions that have this mean, minus H(q)/β₂: the only term that is not
concave is a sum over actions.

**Boxes.** Let l ≤ q ≤ u, and m_a q_a + i_a the secant of −q log q between l_a and u_a. It lies
below −q log q there, so that −H(q) ≤ −Σ (m_a q_a + i_a) in the box, and J is at most what it would
be if −H(q) was that. This objective has the weights q̂_a = e^{−m_a} in place of q and a constant:

    J ≤ cav f_q̂(p₀) − Σ_a i_a/β₂   for every q in the box.

**Multipliers.** For every λ, cav f(p₀) ≤ λ·p₀ + max_μ [f(μ) − λ·μ]. `relaxed` finds λ. With
Λ_λ(r) = (1/β₁) log Σ_ω p₀(ω) e^{β₁ (U r − λ)(ω)}, the maximum over μ is also that of
Λ_λ(r) − KL(r ‖ q̂)/β₂ over responses r ∈ Δ_A, both being the maximum over μ and r of
μ·U r − λ·μ − KL(μ ‖ p₀)/β₁ − KL(r ‖ q̂)/β₂. `largest` bounds whichever is easier.

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
from bra.blahut_arimoto.concave_envelope import Floats, Integers, Landscape, Largest, largest
from bra.blahut_arimoto.reduction import Reduction

CLOSED = 5e-4
"""A gap as small as that, relative to the regret B (see `reduction`), is closed."""

_LOG = logging.getLogger(__name__)
# Seconds between two lines of progress.
_SILENCE = 5.0
# Boxes that are halved together, numbers in one table of theirs, and simplices for each half.
_TOGETHER, _ROOM, _CELLS, _FEW_CELLS = 64, 2**18, 2000, 100
# Sweeps for the multipliers of the first box, and of those that begin where a larger one ended.
_FIRST_SWEEPS, _SWEEPS, _REPAIRS = 400, 60, 4
# In units of B + 1/β₁ + 1/β₂: regrets beyond are cut. In units of 1/B: range of the prices.
_CUT, _LOWEST, _HIGHEST = 1e4, 1e-4, 1e8
# Width that a box has at least, and probability of a percept that is not used.
_WIDTH, _RARE = 1e-12, 1e-12
_EPSILON = float(np.finfo(np.float64).eps)


class Certificate(NamedTuple):
    """What branch and bound has proved."""

    bound: float
    """No J is larger."""
    nodes: int
    """Boxes that were bounded."""


class _Box(NamedTuple):
    """Action marginals between l and u, and where the relaxed problem has its optimum."""

    low: Floats  # (A,)
    high: Floats  # (A,)
    marginal: Floats  # q of the relaxed optimum, (A,)
    response: Floats  # p(a|x), (X, A)
    percept: Floats  # p(x), (X,)


@dataclass
class _Search:
    """Branch and bound over boxes of one problem."""

    utilities: Floats  # (W, A)
    prior: Floats  # (W,)
    beta_1: float
    beta_2: float
    best: float  # J that is known to be attained
    target: float  # gap that is aimed at for now
    deadline: float
    classes: list[list[int]]
    heap: list[tuple[float, int, _Box]] = field(default_factory=list)
    number: Iterator[int] = field(default_factory=count)
    nodes: int = 0

    def __post_init__(self) -> None:
        states, actions = self.utilities.shape
        # Whose exponentials are less sharp, in fewer dimensions.
        self.over_responses = actions * self.beta_1 <= states * self.beta_2
        if self.over_responses:
            self.landscape = Landscape(self.utilities.T.copy(), 1 / self.beta_2, self.beta_1)
        else:
            self.landscape = Landscape(self.utilities, 1 / self.beta_1, self.beta_2)

    @property
    def top(self) -> float:
        """No J is larger, but for rounding."""
        return -self.heap[0][0]

    def begin(self, bound: float) -> None:
        """The box of all marginals, which is known to have a bound."""
        states, actions = self.utilities.shape
        percepts = min(states, actions) + 2
        response = np.full((percepts, actions), 0.1 / actions)
        response[np.arange(percepts), np.arange(percepts) % actions] += 0.9
        low, high = self._tightened(np.zeros(actions), np.ones(actions))
        box = _Box(low, high, high, response, np.full(percepts, 1 / percepts))
        self._add([(bound, box)], _FIRST_SWEEPS)

    def round(self) -> None:
        """Halves the boxes with the largest bounds."""
        halves: list[tuple[float, _Box]] = []
        room = self.utilities.shape[0] * self.heap[0][2].response.size
        together = max(1, min(_TOGETHER, _ROOM // room))
        while self.heap and len(halves) < 2 * together and self.top > self.best + self.target:
            bound, _, box = heapq.heappop(self.heap)
            halves += [(-bound, half) for half in self._halves(box)]
        if halves:
            self._add(halves, _SWEEPS)

    def _halves(self, box: _Box) -> Iterator[_Box]:
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

    def _add(self, boxes: list[tuple[float, _Box]], sweeps: int) -> None:
        """Bounds boxes that are known to have bounds, and remembers them."""
        known, parts = zip(*boxes, strict=True)
        together = _Box(*(np.stack(column) for column in zip(*parts, strict=True)))
        self.nodes += len(parts)
        bounds, together = self._bounded(together, sweeps)
        for bound, *box in zip(np.fmin(bounds, known), *together, strict=True):
            heapq.heappush(self.heap, (-float(bound), next(self.number), _Box(*box)))

    def _bounded(self, boxes: _Box, sweeps: int) -> tuple[Floats, _Box]:
        """Bounds of n boxes, (n,), and the boxes with their relaxed optima."""
        slope, intercept = secant(boxes.low, boxes.high)
        constant = intercept.sum(1) / self.beta_2
        bounds = np.full(len(slope), np.inf)
        percept = 0.97 * boxes.percept + 0.03 / boxes.percept.shape[1]
        boxes = boxes._replace(percept=percept)
        for _ in range(_REPAIRS):
            multipliers, boxes = self.relaxed(boxes, -slope, sweeps)
            value = multipliers @ self.prior - constant
            # What is not going to be proved here is for smaller boxes to prove.
            missing = self.best + self.target - value
            enough = np.where(missing > 0, np.maximum(missing, self.target / 4), value - self.best)
            cells = np.where(missing > self.target / 4, _CELLS, _FEW_CELLS)
            found = self._excess(multipliers, -slope, enough, cells)
            bounds = np.minimum(bounds, value + found.bound)
            if (found.value <= enough).all() or time.monotonic() > self.deadline:
                break
            self._repair(boxes, -slope, found.value > enough, found.point)
        return bounds, boxes

    def relaxed(self, boxes: _Box, log_weights: Floats, sweeps: int) -> tuple[Floats, _Box]:
        """λ (n, W) by Blahut-Arimoto sweeps with fixed log q̂ (n, A): log Z(ω)/β₁ of the last."""
        response, percept = boxes.response, boxes.percept
        for _ in range(sweeps):
            used, taken = percept, response
            cost = (response * (np.log(np.maximum(response, 1e-300)) - log_weights[:, None])).sum(2)
            free_utility = response @ self.utilities.T - cost[..., None] / self.beta_2
            logits = np.log(used)[..., None] + self.beta_1 * free_utility
            highest = logits.max(1, keepdims=True)
            joint = np.exp(logits - highest)
            partition = joint.sum(1, keepdims=True)
            joint *= self.prior / partition
            percept = np.maximum(joint.sum(2), _RARE)
            worth = self.beta_2 * (joint @ self.utilities) / percept[..., None]
            response = np.exp(_normalised(log_weights[:, None] + worth))
            percept = percept / percept.sum(1, keepdims=True)
        marginal = (percept[:, None] @ taken)[:, 0]
        multipliers = (highest + np.log(partition))[:, 0] / self.beta_1
        return multipliers, boxes._replace(marginal=marginal, response=response, percept=percept)

    def _excess(
        self, multipliers: Floats, log_weights: Floats, enough: Floats, cells: Integers
    ) -> Largest:
        """max_μ f_q̂(μ) − λ·μ, over μ or r."""
        log_prior = np.log(self.prior)
        if self.over_responses:
            linear, weights = log_weights / self.beta_2, log_prior - self.beta_1 * multipliers
        else:
            linear, weights = log_prior / self.beta_1 - multipliers, log_weights
        return largest(self.landscape, linear, weights, enough, cells, self.deadline)

    def _repair(self, boxes: _Box, log_weights: Floats, failing: Floats, point: Floats) -> None:
        """Puts a response that is worth more than λ says in place of the rarest percept."""
        for box in np.flatnonzero(failing):
            if self.over_responses:
                response = point[box]
            else:
                logits = log_weights[box] + self.beta_2 * (point[box] @ self.utilities)
                response = np.exp(_normalised(logits))
            rarest = boxes.percept[box].argmin()
            boxes.response[box, rarest] = response
            boxes.percept[box] *= 0.9
            boxes.percept[box, rarest] = 0.1


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
    gap = bound - best
    classes, deadline = interchangeable(utilities, prior), began + seconds
    search = _Search(utilities, prior, beta_1, beta_2, best, gap / 2, deadline, classes)
    search.begin(bound)
    said = began
    while search.top > best + closed:
        if time.monotonic() > deadline or (nodes is not None and search.nodes >= nodes):
            break
        while search.top <= best + search.target:
            search.target = max(closed, search.target / 2)
        search.round()
        if time.monotonic() - said > _SILENCE:
            said = time.monotonic()
            gap = problem.unit * (search.top - best)
            _LOG.info("certify: gap %.2g after %d boxes, %.0f s", gap, search.nodes, said - began)
    slack = 8 * _EPSILON * (sum(utilities.shape) + 16)
    slack *= float(np.ptp(utilities)) + 1500 * (1 / beta_1 + 1 / beta_2)
    return Certificate(min(bound, max(search.top, best) + slack), search.nodes)


def _normalised(logits: Floats) -> Floats:
    """Logits as logarithms of probabilities."""
    logits = logits - logits.max(-1, keepdims=True)
    logs: Floats = logits - np.log(np.exp(logits).sum(-1, keepdims=True))
    return logs
