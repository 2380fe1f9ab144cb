"""The chain Ω → X → A: its self-consistent equations, for a batch of N climbs.

A point of a climb is a pair of p(a|x) and p(x), as logarithms: in these coordinates any real
numbers are admissible after normalisation, so that points can be extrapolated. The batch comes
last: numbers of a climb, such as its prices, broadcast as they are, sums run over leading
dimensions, and the product of a table with all channels is one matrix product.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import ClassVar, NamedTuple, Self

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from bra.blahut_arimoto.mixture_likelihood import MixtureLikelihood, maximise
from bra.information import mutual_information

# A stationary point's gap is second order in the distance from it, E[U] and the information are
# first order: the tolerance is the square of what they should meet, relative to the regret.
CLIMB_TOLERANCE = 1e-14

# Logarithm of the probability of an action that is not taken.
_NEVER = -1e4
EPSILON = torch.finfo(torch.float64).eps
# A percept or action this rare has no weight in any sum, but keeps a logarithm, so that it can
# come back. Percepts go lower: one that nobody needs must not seem to need an action.
PERCEPT_FLOOR = 1e-250
ACTION_FLOOR = 1e-200


class Sweep(NamedTuple):
    """One round of the self-consistent equations, from the action channel to the next one."""

    log_partition: Tensor
    """log Z(ω) of the new perception, shape (W, N)."""
    action_marginal: Tensor
    """p(a) of the old action channel, shape (A, 1, N)."""
    percept_marginal: Tensor
    """p(x) of the new perception, shape (X, N)."""
    drive: Tensor
    """What moves p(a|x) under the new perception, E[U|x] for every action, shape (A, X, N)."""
    point: Tensor
    """The new p(x), and the best action channel for the new perception."""


class PerceptFree(NamedTuple):
    """The best that can be done without percepts."""

    value: Tensor
    """Its J, (N,)."""
    information: Tensor
    """I(Ω;A), (N,)."""
    log_marginal: Tensor
    """log p(a), (A, N)."""
    action: Tensor
    """The action channel, as in `channels`, the same for every percept."""


class Perception(NamedTuple):
    """Perception that is best for a point of a climb."""

    percept_given_state: Tensor  # (W, X, N)
    log_partition: Tensor  # log Z(ω), (W, N)
    action_marginal: Tensor  # (A, 1, N)
    free_utility: Tensor  # ΔF(ω,x), (W, X, N)


@dataclass(frozen=True)
class SerialProblem:
    """The serial problem with its prices, one pair for each of N climbs.

    Points have shape (A + 1, X, N): log p(a|x) in the first A rows, log p(x) in the last.
    """

    utilities: Tensor  # (W, A), each state's best is zero
    prior: Tensor  # (W,)
    beta_1: Tensor  # (N,)
    beta_2: Tensor  # (N,)
    regret: Tensor  # What an optimum can lose against the best action everywhere, (N,)

    solver: ClassVar[str] = "serial"
    """Whose name warnings and lines of progress bear."""
    per_climb: ClassVar[tuple[str, ...]] = ("beta_1", "beta_2", "regret")
    reach: ClassVar[float] = math.inf
    """Half of what a leap may add to a logarithm."""
    single_precision: ClassVar[bool] = True
    """Whether sweeps make sense in float32."""

    def select(self, keep: Tensor) -> Self:
        """The same problem for some of the climbs."""
        return replace(self, **{name: getattr(self, name)[keep] for name in self.per_climb})

    def single(self) -> Self:
        """The same problem in float32."""
        return replace(self, **{f.name: getattr(self, f.name).float() for f in fields(self)})

    def tolerance(self) -> Tensor:
        """Largest certified gap of a climb that has converged, shape (N,)."""
        # Sums of probabilities are known to a few ε, and what they certify to a few ε/β.
        epsilon = torch.finfo(self.utilities.dtype).eps
        rounding = 16 * epsilon * (1 / self.beta_1 + 1 / self.beta_2)
        return CLIMB_TOLERANCE * self.regret + rounding

    def perceive(self, point: Tensor) -> Perception:
        """p(x|ω) ∝ p(x) e^{β₁ΔF(ω,x)}, ΔF(ω,x) = E_{p(a|x)}[U(ω,a)] − (1/β₂) KL(p(a|x) ‖ p(a))."""
        probabilities = point.exp()
        action, marginal = probabilities[:-1], self.action_marginal(probabilities)
        divergence = (point[:-1] - marginal.log()).mul_(action).sum(0)
        free_utility = _apply(self.utilities, action).addcdiv_(divergence, self.beta_2, value=-1)
        return self.attend(point[-1], free_utility, marginal)

    def action_marginal(self, probabilities: Tensor) -> Tensor:
        """p(a) = Σ p(x) p(a|x), (A, 1, N), of p(a|x) and p(x)."""
        joint = probabilities[-1] * probabilities[:-1]
        return joint.sum(1, keepdim=True).clamp_(min=_floor(ACTION_FLOOR, joint))

    def attend(self, log_percept: Tensor, free_utility: Tensor, marginal: Tensor) -> Perception:
        """p(x|ω) ∝ p(x) e^{β₁ΔF(ω,x)} for log p(x) (X, N), ΔF (W, X, N) and p(a) (A, 1, N)."""
        logits = torch.addcmul(log_percept, self.beta_1, free_utility)
        highest = logits.amax(1, keepdim=True)
        weights = logits.sub_(highest).exp_()
        partition = weights.sum(1, keepdim=True)
        log_partition = (highest + partition.log()).squeeze(1)
        return Perception(weights.div_(partition), log_partition, marginal, free_utility)

    def sweep(self, point: Tensor) -> Sweep:
        """Perception, its marginal, and the action channel p(a|x) ∝ p(a) e^{β₂E[U|x]}."""
        percept_given_state, log_partition, marginal, _ = self.perceive(point)
        joint = percept_given_state.mul_(self.prior[:, None, None])
        percept = joint.sum(0).clamp_(min=_floor(PERCEPT_FLOOR, joint))
        worth = _apply(self.utilities.mT, joint).div_(percept)
        point = self._respond(marginal, percept, worth)
        return Sweep(log_partition, marginal, percept, worth, point)

    def objective(self, sweep: Sweep) -> Tensor:
        """J of a sweep's old action channel and the best perception for it, shape (N,)."""
        return self.prior @ sweep.log_partition / self.beta_1

    def gap(self, before: Sweep, after: Sweep) -> Tensor:
        """What either block could gain at the point between two sweeps (see `serial`), (N,).

        Growth is known to ε |log p|, to which marginals are, whose logarithms are held.
        """
        epsilon = torch.finfo(self.utilities.dtype).eps
        percept, action = before.percept_marginal, before.action_marginal
        percept_growth = (after.percept_marginal / percept).log() + epsilon * percept.log()
        action_growth = (after.action_marginal / action).log() + epsilon * action.log()
        return percept_growth.amax(0) / self.beta_1 + action_growth.amax((0, 1)) / self.beta_2

    def renew(self, sweep: Sweep) -> Tensor:
        """Point after a sweep with the marginals that are best for each block, by Newton steps.

        Sweeps move log p(x) and log p(a) by at most β₁ and β₂ times the span of the utilities;
        where one price is small and the other large they would take millions.
        """
        percept = sweep.percept_marginal
        action_block = MixtureLikelihood(sweep.drive.permute(2, 1, 0), percept.mT, self.beta_2)
        marginal = maximise(action_block).q.mT[:, None].clamp(min=ACTION_FLOOR)
        point = self._respond(marginal, percept, sweep.drive)
        free_utility = self.perceive(point).free_utility.permute(2, 0, 1)
        percept = maximise(MixtureLikelihood(free_utility, self.prior, self.beta_1)).q.mT
        return torch.cat((point[:-1], percept.clamp(min=PERCEPT_FLOOR).log()[None]))

    def respond(self, log_marginal: Tensor, joint: Tensor) -> Tensor:
        """Log p(a|x) (A, X, N) of action channels p(a) e^{β₂E[U|x]} for p(ω,x) (W, X, N).

        Args:
            log_marginal: log p(a), up to a constant, as far as it matters, (A, 1, N).
            joint: p(ω,x), up to a factor for every percept.
        """
        worth = _apply(self.utilities.mT, joint) / joint.sum(0).clamp(min=PERCEPT_FLOOR)
        return (log_marginal + self.beta_2 * worth).log_softmax(0)

    def percept_free(self) -> PerceptFree:
        """The best single action."""
        constant = self.prior @ self.utilities
        single = one_hot(constant.argmax(), len(constant)).to(constant)
        rows = single.log().clamp(min=_NEVER)[:, None].expand(-1, len(self.beta_1))
        value = constant.amax().expand_as(self.beta_1)
        return PerceptFree(value, torch.zeros_like(value), rows, single.expand(1, 1, -1))

    def channels(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """p(x|ω), (N, W, X), and p(a|x), (N, X, A), at a point."""
        perception = self.perceive(point).percept_given_state
        return perception.permute(2, 0, 1), point[:-1].exp().permute(2, 1, 0)

    def terms(self, perception: Tensor, action: Tensor) -> dict[str, Tensor]:
        """J, its terms and all distributions for channels (N, W, X) and (N, X, A)."""
        percept_marginal = self.prior @ perception
        behaviour = perception @ action
        expected_utility = (behaviour * self.utilities).sum(2) @ self.prior
        perception_information = mutual_information(self.prior, perception)
        action_information = mutual_information(percept_marginal, action)
        cost = perception_information / self.beta_1 + action_information / self.beta_2
        return {
            "objective": expected_utility - cost,
            "expected_utility": expected_utility,
            "perception_information": perception_information,
            "action_information": action_information,
            "end_to_end_information": mutual_information(self.prior, behaviour),
            "action_given_state": behaviour,
            "percept_given_state": perception,
            "action_given_percept": action,
            "percept_marginal": percept_marginal,
            "action_marginal": self.prior @ behaviour,
        }

    def _respond(self, marginal: Tensor, percept: Tensor, worth: Tensor) -> Tensor:
        """Point with p(a|x) ∝ p(a) e^{β₂E[U|x]}."""
        logits = torch.addcmul(marginal.log(), self.beta_2, worth)
        return torch.cat((logits.log_softmax(0), percept.log()[None]))


def _apply(table: Tensor, channels: Tensor) -> Tensor:
    """Product of a table (R, C) with all channels (C, X, N), shape (R, X, N)."""
    return (table @ channels.flatten(1)).view(-1, *channels.shape[1:])


def _floor(least: float, values: Tensor) -> float:
    """The least value, or the least that values of this kind can have."""
    return max(least, torch.finfo(values.dtype).tiny)
