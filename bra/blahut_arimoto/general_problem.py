"""The general case, in which the action looks at the state again: its self-consistent equations.

A point of a climb holds log p(a|x) and log p(x), as in `serial_problem`. For c₁ + c₂ < c₃, cᵢ =
1/βᵢ, and only there is anything to search (see `general`), J is the maximum of

    E[U − c₁ log p(x|ω)/p(x) + c₂ log p(a) + (c₃ − c₂) log p(a|x) − c₃ log p(a|x,ω)]

over its arguments one by one: over p(a|x,ω), given the rest, at

    p(a|x,ω) = p(a|x)^{1−s} p(a)^s e^{β₃U(ω,a)} / Z(x,ω),   s = β₃/β₂,

over p(x|ω) where it is proportional to p(x) e^{β₁ΔF}, ΔF = c₃ log Z, and over p(a|x), p(a) and p(x)
at the marginals. So J rises with every line.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from bra.blahut_arimoto import one_channel
from bra.blahut_arimoto.mixture_likelihood import MixtureLikelihood, maximise
from bra.blahut_arimoto.serial_problem import (
    EPSILON,
    PERCEPT_FLOOR,
    PerceptFree,
    Perception,
    SerialProblem,
    Sweep,
)
from bra.information import mutual_information

# β₂ from which responses to a perception count as certain, per unit of utility.
_SHARPEST = 30.0


# Where an action is this rare in a percept it has no weight in any sum. It keeps a logarithm, from
# which each sweep of a percept that needs it leads away by a factor.
_FLOOR = 1e-25
_TINY = 1e-12


@dataclass(frozen=True)
class GeneralProblem(SerialProblem):
    """The serial problem with actions that look at the state again, at a third price."""

    beta_3: Tensor  # (N,), β₁₂ > β₃ unless percepts are worthless

    solver: ClassVar[str] = "general"
    per_climb: ClassVar[tuple[str, ...]] = (*SerialProblem.per_climb, "beta_3")
    # A leap that lifts actions from the floor to the top exchanges them with those it meets there.
    reach: ClassVar[float] = 10.0
    single_precision: ClassVar[bool] = False

    def look(self, point: Tensor) -> tuple[Perception, Tensor]:
        """The best perception for a point, and p(a|x,ω) / p(a|x) − 1, (W, A, X, N)."""
        log_action, marginal = point[:-1], self.action_marginal(point.exp())
        worth = self.utilities[:, :, None, None] - (log_action - marginal.log()) / self.beta_2
        exponent = self.beta_3 * worth
        log_partition = (log_action + exponent).logsumexp(1)
        # Where Z is near one the differences between percepts would be lost in its rounding.
        excess = (log_action.exp() * exponent.clamp(max=1.0).expm1()).sum(1)
        near = (exponent.amax(1) < 1.0) & (excess > -0.5)
        log_partition = torch.where(near, excess.clamp(min=-0.5).log1p(), log_partition)
        perception = self.attend(point[-1], log_partition / self.beta_3, marginal)
        return perception, (exponent - log_partition[:, None]).expm1()

    def perceive(self, point: Tensor) -> Perception:
        """The best perception for a point; see `look`."""
        return self.look(point)[0]

    def sweep(self, point: Tensor) -> Sweep:
        """Perception, its marginal, and the mean of p(a|x,ω) over the states of x, or beyond.

        Let D(a|x) be by how much that mean exceeds p(a|x). As β₃ → 0 D goes to 1, and p(a|x) to
        p(a|x) D^{1/s} = p(a) e^{β₂E[U|x]}. In general the curvature of J in log p(a|x) is at most
        1 − (1 − s)κ times the variance under p(a|x), κ = Σ p(ω|x) min_a p(a|x,ω)/p(a|x), since
        p(a|x,ω) has at least κ times that variance. So steps are 1/(1 − (1 − s)κ) ≥ 1 times as
        long, if that lifts no action by more than one nat.
        """
        point = torch.cat((point[:-1].clamp(min=math.log(_FLOOR)), point[-1:]))
        perception, excess = self.look(point)
        joint = perception.percept_given_state * self.prior[:, None, None]
        percept = joint.sum(0).clamp(min=PERCEPT_FLOOR)
        posterior = joint / percept
        growth = (posterior[:, None] * excess).sum(0).clamp(min=EPSILON - 1).log1p()
        shrinking = -(posterior * excess.amin(1)).sum(0)  # 1 − κ
        s = self.beta_3 / self.beta_2
        longest = 1 / growth.amax(0).clamp(min=_TINY)
        length = (1 / (s + (1 - s) * shrinking.clamp(min=_TINY))).minimum(longest).clamp(min=1.0)
        rows = (point[:-1] + length * growth).clamp(min=math.log(_FLOOR)).log_softmax(0)
        rows = torch.where(percept > PERCEPT_FLOOR, rows, point[:-1])
        return Sweep(
            log_partition=perception.log_partition,
            action_marginal=perception.action_marginal,
            percept_marginal=percept,
            drive=growth,
            point=torch.cat((rows, percept.log()[None])),
        )

    def gap(self, before: Sweep, after: Sweep) -> Tensor:
        """What either block could gain at the point between two sweeps (see `general`), (N,)."""
        percept_growth = (after.percept_marginal / before.percept_marginal).amax(0)
        mean = after.percept_marginal * (before.point[:-1] + after.drive).exp()
        marginal_growth = (mean.sum(1, keepdim=True) / after.action_marginal).amax((0, 1))
        highest = (after.percept_marginal * after.drive.amax(0)).sum(0)
        gain = highest * (1 / self.beta_3 - 1 / self.beta_2) + marginal_growth.log() / self.beta_2
        return percept_growth.log() / self.beta_1 + gain

    def renew(self, sweep: Sweep) -> Tensor:
        """The point after a sweep, with the p(x) that is best for it, by Newton steps."""
        free_utility = self.perceive(sweep.point).free_utility.permute(2, 0, 1)
        percept = maximise(MixtureLikelihood(free_utility, self.prior, self.beta_1)).q.mT
        return torch.cat((sweep.point[:-1], percept.clamp(min=PERCEPT_FLOOR).log()[None]))

    def respond(self, log_marginal: Tensor, joint: Tensor) -> Tensor:
        """Log p(a|x) (A, X, N) near the best ones for p(ω,x) (W, X, N); see `SerialProblem`.

        The mean of p(a) e^{β₂E[U|x] + β₃(U − E[U|x])} over the states of x: exact as β₃ → 0 and for
        a single state.
        """
        posterior = joint / joint.sum(0).clamp(min=PERCEPT_FLOOR)
        worth = torch.einsum("wa,wxn->axn", self.utilities, posterior)
        sharpness = torch.maximum(self.beta_3, self.beta_2.clamp(max=_SHARPEST))
        deviation = self.utilities[:, :, None, None] - worth
        logits = log_marginal + sharpness * worth + self.beta_3 * deviation
        rows = (posterior[:, None] * logits.softmax(1)).sum(0)
        return rows.clamp(min=_FLOOR).log().log_softmax(0)

    def percept_free(self) -> PerceptFree:
        """One channel at β₃."""
        single = one_channel.solve(self.utilities, self.prior, self.beta_3)
        rows = single.marginal.mT.clamp(min=_FLOOR).log()
        return PerceptFree(single.objective, single.information, rows, single.channel[:, None])

    def channels(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """p(x|ω), (N, W, X), and p(a|x,ω), (N, X, W, A), at a point."""
        perception, excess = self.look(point)
        action = point[:-1].exp() * (1 + excess)
        return perception.percept_given_state.permute(2, 0, 1), action.permute(3, 2, 0, 1)

    def terms(self, perception: Tensor, action: Tensor) -> dict[str, Tensor]:
        """J, its terms and all distributions for channels (N, W, X) and (N, X, W, A)."""
        joint = (self.prior[:, None] * perception).mT  # (N, X, W)
        percept = joint.sum(2)
        used = percept[..., None] > PERCEPT_FLOOR
        posterior = torch.where(used, joint / percept[..., None], self.prior)
        mean = (posterior[:, :, None] @ action).squeeze(2)
        direct = (percept * mutual_information(posterior, action)).sum(1)
        behaviour = (perception.mT[..., None] * action).sum(1)
        terms = super().terms(perception, mean)
        expected_utility = (behaviour * self.utilities).sum(2) @ self.prior
        cost = terms["perception_information"] / self.beta_1
        cost = cost + terms["action_information"] / self.beta_2 + direct / self.beta_3
        return terms | {
            "objective": expected_utility - cost,
            "expected_utility": expected_utility,
            "direct_information": direct,
            "end_to_end_information": mutual_information(self.prior, behaviour),
            "action_given_state": behaviour,
            "action_marginal": self.prior @ behaviour,
            "action_given_percept_and_state": action,
        }
