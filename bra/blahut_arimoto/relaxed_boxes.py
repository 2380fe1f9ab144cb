"""Upper bounds on J for boxes of the action marginal, with secants in place of its entropy.

f_q is that of `certificate`. Let l ≤ q ≤ u, and m_a q_a + i_a the secant of −q log q between l_a
and u_a. It lies below −q log q there, so that −H(q) ≤ −Σ (m_a q_a + i_a) in the box, and J is at
most what it would be if −H(q) was that. This objective has the weights q̂_a = e^{−m_a} in place of
q and a constant:

    J ≤ cav f_q̂(p₀) − Σ_a i_a/β₂   for every q in the box.

**Multipliers.** For every λ, cav f(p₀) ≤ λ·p₀ + max_μ [f(μ) − λ·μ]. `Relaxation.relaxed` finds λ.
With Λ_λ(r) = (1/β₁) log Σ_ω p₀(ω) e^{β₁ (U r − λ)(ω)}, the maximum over μ is also that of
Λ_λ(r) − KL(r ‖ q̂)/β₂ over responses r ∈ Δ_A, both being the maximum over μ and r of
μ·U r − λ·μ − KL(μ ‖ p₀)/β₁ − KL(r ‖ q̂)/β₂. `Covers.largest` bounds whichever is easier, and begins
with the cells that did for the box's larger one.
"""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bra.blahut_arimoto.action_boxes import secant
from bra.blahut_arimoto.concave_envelope import Floats, Integers, Landscape
from bra.blahut_arimoto.simplex_covers import Covers, Largest

# Share of the gap to close that the relaxed problem may leave where a box is to be closed at once.
_SURE = 0.95
# Times that the multipliers are mended, and cells to look at for each box in between.
_REPAIRS, _CELLS = 4, 500
# Probability of a percept that is not used.
_RARE = 1e-12


class Box(NamedTuple):
    """Action marginals between l and u, and where the relaxed problem has its optimum.

    Of several boxes the entries have a leading dimension.
    """

    low: Floats  # (A,)
    high: Floats  # (A,)
    marginal: Floats  # q of the relaxed optimum, (A,)
    response: Floats  # p(a|x), (X, A)
    percept: Floats  # p(x), (X,)

    @classmethod
    def stacked(cls, boxes: Sequence["Box"]) -> "Box":
        """Boxes as one."""
        return cls(*(np.stack(column) for column in zip(*boxes, strict=True)))


class Bounded(NamedTuple):
    """What was found of n boxes."""

    bound: Floats
    """No J in the box is larger, (n,)."""
    value: Floats
    """The largest J of the relaxed problem, as far as it is known, (n,)."""
    boxes: Box
    """The boxes with their relaxed optima."""
    covers: list[Integers]
    """Cells that they were bounded in."""


class Relaxation:
    """One problem, with secants in place of the entropy of its action marginal.

    Args:
        utilities: U(ω,a), (W, A).
        prior: p(ω) > 0, (W,).
        beta_1: β₁.
        beta_2: β₂.
    """

    def __init__(self, utilities: Floats, prior: Floats, beta_1: float, beta_2: float) -> None:
        self.utilities, self.prior, self.beta_1, self.beta_2 = utilities, prior, beta_1, beta_2
        states, actions = utilities.shape
        # Whose exponentials are less sharp, in fewer dimensions.
        self.over_responses = actions * beta_1 <= states * beta_2
        if self.over_responses:
            self.covers = Covers(Landscape(utilities.T.copy(), 1 / beta_2, beta_1))
        else:
            self.covers = Covers(Landscape(utilities, 1 / beta_1, beta_2))

    def first(self, low: Floats, high: Floats) -> Box:
        """A box whose relaxed optimum is not known."""
        states, actions = self.utilities.shape
        percepts = min(states, actions) + 2
        response = np.full((percepts, actions), 0.1 / actions)
        response[np.arange(percepts), np.arange(percepts) % actions] += 0.9
        return Box(low, high, high, response, np.full(percepts, 1 / percepts))

    def bounded(
        self,
        boxes: Box,
        covers: list[Integers],
        bounds: Floats,
        best: float,
        closed: float,
        sweeps: int,
        deadline: float,
    ) -> Bounded:
        """Bounds of n boxes.

        The maximum over μ is pursued where that closes a box, or halves what its bound leaves.

        Args:
            boxes: With relaxed optima to begin at.
            covers: Cells to begin with.
            bounds: Known already, (n,).
            best: J that is known to be attained.
            closed: A bound that exceeds it by no more need not be smaller.
            sweeps: Of Blahut-Arimoto.
            deadline: When to stop, of `time.monotonic`.
        """
        slope, intercept = secant(boxes.low, boxes.high)
        boxes = boxes._replace(percept=0.97 * boxes.percept + 0.03 / boxes.percept.shape[1])
        for _ in range(_REPAIRS):
            multipliers, boxes = self.relaxed(boxes, -slope, sweeps)
            value = multipliers @ self.prior - intercept.sum(1) / self.beta_2
            lead = value - best
            enough = np.where(lead > _SURE * closed, lead, closed - lead)
            enough[value + enough >= bounds] = np.inf
            found = self._excess(multipliers, -slope, covers, enough, deadline)
            covers, bounds = found.covers, np.fmin(bounds, value + found.bound)
            failing = found.value > enough
            if not failing.any() or time.monotonic() > deadline:
                break
            self._repair(boxes, -slope, failing, found.point)
        return Bounded(bounds, value, boxes, covers)

    def relaxed(self, boxes: Box, log_weights: Floats, sweeps: int) -> tuple[Floats, Box]:
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
        self,
        multipliers: Floats,
        log_weights: Floats,
        covers: list[Integers],
        enough: Floats,
        deadline: float,
    ) -> Largest:
        """max_μ f_q̂(μ) − λ·μ, over μ or r."""
        log_prior = np.log(self.prior)
        if self.over_responses:
            linear, weights = log_weights / self.beta_2, log_prior - self.beta_1 * multipliers
        else:
            linear, weights = log_prior / self.beta_1 - multipliers, log_weights
        return self.covers.largest(linear, weights, covers, enough, _CELLS, deadline)

    def _repair(self, boxes: Box, log_weights: Floats, failing: Floats, point: Floats) -> None:
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


def _normalised(logits: Floats) -> Floats:
    """Logits as logarithms of probabilities."""
    logits = logits - logits.max(-1, keepdims=True)
    logs: Floats = logits - np.log(np.exp(logits).sum(-1, keepdims=True))
    return logs
