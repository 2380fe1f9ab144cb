"""Reference optima of bounded-rational channels by Blahut-Arimoto, with certificates.

`rate_distortion` solves one channel Ω → A, a concave problem with one optimum. `serial` solves the
chain Ω → X → A, which has local optima: it runs many starts as one batch and reports them all.
Both say how far above the returned objective the true optimum can lie at most.

Everything is float64 and in nats. Prices β are per nat.
"""

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from bra.information import mutual_information


class SupportsArray(Protocol):
    """NumPy arrays, and what turns into one."""

    def __array__(self) -> Any:
        """The array."""


ArrayLike = Tensor | SupportsArray | Sequence[float] | Sequence[Sequence[float]]
"""What `torch.as_tensor` reads."""

# Certified gaps at which a solve has converged, relative to the span of the utilities. At a
# stationary point a gap is second order in the distance from it, E[U] and the information are
# first order: the tolerance of a climb, which ends there, is the square of what they should meet.
GAP_TOLERANCE = 1e-12
CLIMB_TOLERANCE = 1e-14

NEWTON_CAP = 100
SWEEP_CAP = 10_000

_EPSILON = torch.finfo(torch.float64).eps
_TINY = torch.finfo(torch.float64).tiny
# A percept or action this rare has no weight in any sum, but keeps a logarithm, so that it can
# come back. Percepts go lower: one that nobody needs must not seem to need an action.
_PERCEPT_FLOOR = 1e-250
_ACTION_FLOOR = 1e-200
# Steps of SQUAREM may grow as long as they pay, from here.
_FIRST_LIMIT = 64.0
# Cycles of three sweeps between two renewals of the marginals by Newton steps.
_RENEWAL = 100


@dataclass(frozen=True)
class RateDistortion:
    """Optimum of one channel Ω → A: J = E[U] − (1/β) I(Ω;A).

    For a tensor of prices every entry has its shape (...) in front; for one price the scalars are
    Python numbers.

    Attributes:
        objective: J of the returned channel, in utility units.
        expected_utility: E[U(ω,a)].
        end_to_end_information: I(Ω;A) in nats.
        action_given_state: p(a|ω), shape (..., W, A).
        action_marginal: p(a) = Σ p(ω) p(a|ω), shape (..., A).
        upper_bound: No channel has a larger J than this; `objective + gap`.
        gap: Certified distance from J to the optimum, in utility units.
        iterations: Newton steps taken.
        converged: Whether the gap reached the tolerance.
    """

    objective: float | Tensor
    expected_utility: float | Tensor
    end_to_end_information: float | Tensor
    action_given_state: Tensor
    action_marginal: Tensor
    upper_bound: float | Tensor
    gap: float | Tensor
    iterations: int | Tensor
    converged: bool | Tensor


@dataclass(frozen=True)
class Serial:
    """Best optimum found of the chain Ω → X → A: J = E[U] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A).

    For tensors of prices every entry has their broadcast shape (...) in front; for two numbers the
    scalars are Python numbers.

    Attributes:
        objective: J of the returned channels, in utility units: the first of `optima` that equals
            the largest up to the tolerance.
        expected_utility: E[U(ω,a)].
        perception_information: I(Ω;X) in nats.
        action_information: I(X;A) in nats.
        end_to_end_information: I(Ω;A) in nats.
        action_given_state: p(a|ω) = Σ p(x|ω) p(a|x), shape (..., W, A).
        percept_given_state: p(x|ω), shape (..., W, X).
        action_given_percept: p(a|x), shape (..., X, A). The row of a percept that is never used
            says nothing.
        percept_marginal: p(x) = Σ p(ω) p(x|ω), shape (..., X).
        action_marginal: p(a) = Σ p(x) p(a|x), shape (..., A).
        upper_bound: No pair of channels, whatever the number of percepts, has a larger J.
        optima: J at the end of every restart, shape (..., restarts).
        iterations: Blahut-Arimoto sweeps of the restart that took most.
        converged: Whether every restart ended at a certified stationary point.
    """

    objective: float | Tensor
    expected_utility: float | Tensor
    perception_information: float | Tensor
    action_information: float | Tensor
    end_to_end_information: float | Tensor
    action_given_state: Tensor
    percept_given_state: Tensor
    action_given_percept: Tensor
    percept_marginal: Tensor
    action_marginal: Tensor
    upper_bound: float | Tensor
    optima: Tensor
    iterations: int | Tensor
    converged: bool | Tensor


def rate_distortion(
    utilities: ArrayLike, prior: ArrayLike | None, beta: float | ArrayLike
) -> RateDistortion:
    """Optimum of one channel, max over p(a|ω) of E[U(ω,a)] − (1/β) I(Ω;A).

    The optimum has the form p(a|ω) = q(a) e^{βU(ω,a)} / Z(ω), Z(ω) = Σ_a q(a) e^{βU(ω,a)}, and
    maximises the concave function

        G(q) = (1/β) Σ_ω p(ω) log Z(ω)

    over distributions q. Blahut-Arimoto climbs G by q(a) ← q(a) D(a) with
    D(a) = Σ_ω p(ω) e^{βU(ω,a)} / Z(ω), which is the EM algorithm for mixture proportions and takes
    arbitrarily many steps where an action is about to enter the support. Newton steps on the same
    function (a primal-dual interior-point method) take ten to twenty anywhere. Either way the
    stopping rule is the certificate J* − G(q) ≤ (1/β) log max_a D(a), which holds for every q.

    Args:
        utilities: U(ω,a), shape (W, A), finite.
        prior: p(ω), shape (W,); None for uniform.
        beta: Price β > 0 of information, per nat; a number or a tensor of any shape.

    Returns:
        The optimum, one for each price.

    Raises:
        TypeError: If an argument cannot be read as numbers.
        ValueError: If a number is not admissible.
    """
    table, p = _check_problem(utilities, prior)
    prices = _check_price(beta, "beta")
    solution = _solve_one_channel(table, p, prices.flatten())
    if not solution.converged.all():
        _warn_cap("rate_distortion", solution.converged, f"{NEWTON_CAP} Newton steps", solution.gap)
    shape = prices.shape
    return RateDistortion(
        objective=_shaped(solution.objective, shape),
        expected_utility=_shaped(solution.expected_utility, shape),
        end_to_end_information=_shaped(solution.information, shape),
        action_given_state=solution.channel.reshape(*shape, *table.shape),
        action_marginal=solution.marginal.reshape(*shape, -1),
        upper_bound=_shaped(solution.objective + solution.gap, shape),
        gap=_shaped(solution.gap, shape),
        iterations=_shaped(solution.iterations, shape),
        converged=_shaped(solution.converged, shape),
    )


def serial(
    utilities: ArrayLike,
    prior: ArrayLike | None,
    percepts: int,
    beta_perception: float | ArrayLike,
    beta_action: float | ArrayLike,
    restarts: int = 32,
    seed: int = 0,
) -> Serial:
    """Best optimum found of E[U(ω,a)] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) over p(x|ω) and p(a|x).

    Each restart climbs by the self-consistent equations (Genewein, Leibfried, Grau-Moya and Braun
    2015, section 4)

        p(a|x) ∝ p(a) exp(β₂ Σ_ω p(ω|x) U(ω,a))
        p(x|ω) ∝ p(x) exp(β₁ ΔF(ω,x)),  ΔF(ω,x) = E_{p(a|x)}[U(ω,a)] − (1/β₂) KL(p(a|x) ‖ p(a))

    with the marginals p(x) and p(a) renewed after each sweep. Every line maximises the same
    functional in one of its arguments, so J never falls. Squared extrapolation (SQUAREM, Varadhan
    and Roland 2008) shortens the way; an extrapolated point that lies below its base is thrown
    away, so J never falls there either.

    A restart has converged when neither block can gain: with p(a|x) and p(a) held, perception is a
    one-channel problem with utility ΔF; with p(x|ω) held, action is one with utility E[U|x]; and
    the certificates of the two (see `rate_distortion`),

        (1/β₁) log max_x Σ_ω p(ω) e^{β₁ΔF(ω,x)} / Z(ω)
        + (1/β₂) log max_a Σ_x p(x) e^{β₂E[U(ω,a)|x]} / Z(x),

    sum to less than the tolerance. That proves a stationary point, not a global optimum.

    The upper bound is global. By data processing I(Ω;A) is at most I(Ω;X) and at most I(X;A), so
    J ≤ E[U] − (1/β₁ + 1/β₂) I(Ω;A), which is at most the one-channel optimum at
    1/β = 1/β₁ + 1/β₂, which is at most the returned value of that plus its certified gap.

    Args:
        utilities: U(ω,a), shape (W, A), finite.
        prior: p(ω), shape (W,); None for uniform.
        percepts: Number of percepts |X|.
        beta_perception: Price β₁ > 0 of I(Ω;X), per nat; a number or a tensor.
        beta_action: Price β₂ > 0 of I(X;A), per nat; a number or a tensor. The two are broadcast
            against each other.
        restarts: Number of starts for each pair of prices.
        seed: Seed of the random starts.

    Returns:
        The best restart, one for each pair of prices.

    Raises:
        TypeError: If an argument cannot be read as numbers, or a count is not an integer.
        ValueError: If a number is not admissible.
    """
    table, p = _check_problem(utilities, prior)
    _check_count(percepts, "percepts")
    _check_count(restarts, "restarts")
    beta_1, beta_2 = _broadcast(
        _check_price(beta_perception, "beta_perception"), _check_price(beta_action, "beta_action")
    )
    shape = beta_1.shape
    cells = beta_1.numel()

    centred, offset = _centre(table, p)
    chain = _Chain(
        utilities=centred,
        prior=p,
        percepts=percepts,
        beta_1=beta_1.flatten().repeat_interleave(restarts),
        beta_2=beta_2.flatten().repeat_interleave(restarts),
    )
    bound = _solve_one_channel(table, p, 1 / (1 / beta_1 + 1 / beta_2).flatten())
    climb = _climb(chain, _starts(chain, bound.channel, restarts, seed))
    if not climb.converged.all():
        _warn_cap("serial", climb.converged, f"{SWEEP_CAP} sweeps", climb.gap)

    terms = _score(chain, climb.point)
    optima = terms.objective.view(cells, restarts)
    # The first among equals, so that rounding does not choose between names of percepts.
    level = optima.amax(1, keepdim=True) - 100 * chain.tolerance().view(cells, restarts)
    best = (optima >= level).double().argmax(1) + restarts * torch.arange(cells)

    def shaped(per_restart: Tensor) -> Tensor:
        chosen = per_restart[best]
        return chosen.reshape(*shape, *chosen.shape[1:])

    return Serial(
        objective=_shaped(terms.objective[best] + offset, shape),
        expected_utility=_shaped(terms.expected_utility[best] + offset, shape),
        perception_information=_shaped(terms.perception_information[best], shape),
        action_information=_shaped(terms.action_information[best], shape),
        end_to_end_information=_shaped(terms.end_to_end_information[best], shape),
        action_given_state=shaped(terms.action_given_state),
        percept_given_state=shaped(terms.percept_given_state),
        action_given_percept=shaped(terms.action_given_percept),
        percept_marginal=shaped(terms.percept_marginal),
        action_marginal=shaped(terms.action_marginal),
        upper_bound=_shaped(bound.objective + bound.gap, shape),
        optima=(optima + offset).reshape(*shape, restarts),
        iterations=_shaped(climb.sweeps.view(cells, restarts).amax(1), shape),
        converged=_shaped(climb.converged.view(cells, restarts).all(1), shape),
    )


# One channel


class _OneChannel(NamedTuple):
    objective: Tensor  # (B,)
    expected_utility: Tensor  # (B,)
    information: Tensor  # (B,)
    channel: Tensor  # (B, W, A)
    marginal: Tensor  # (B, A)
    gap: Tensor  # (B,)
    iterations: Tensor  # (B,)
    converged: Tensor  # (B,)


class _Mixture:
    """The concave function h(q) = (1/κ) Σ_ω p(ω) log Z(ω), for a batch of B problems.

    h is G of `rate_distortion` in units of κ/β = min(span of U, 1/β), in which its slopes are of
    order one at any price. Z is held as s + M q with either s = 0, M = e^{βU}, or, where βU is
    small, s = 1, M = e^{βU} − 1, since there the differences between actions would be lost in
    the rounding of the ones.

    Args:
        utilities: Shape (W, A) or (B, W, A).
        prior: Shape (W,) or (B, W).
        beta: Shape (B,).
    """

    def __init__(self, utilities: Tensor, prior: Tensor, beta: Tensor) -> None:
        # Each state's best action is worth zero, and a state that never occurs bears no weight.
        centred = utilities - utilities.amax(-1, keepdim=True)
        exponent = beta[:, None, None] * torch.where(prior[..., None] > 0, centred, 0.0)
        steepness = -exponent.amin((1, 2))
        self.prior = prior
        self.small = (steepness < 1)[:, None]
        self.scale = torch.where(steepness > 0, steepness, 1.0).clamp(max=1.0)[:, None]
        self.kernel = torch.where(self.small[..., None], exponent.expm1(), exponent.exp())

    def partition(self, q: Tensor) -> Tensor:
        """Z(ω), shape (B, W)."""
        return self.small + (self.kernel @ q[..., None]).squeeze(-1)

    def slope(self, q: Tensor) -> Tensor:
        """Gradient of h less its mean under q, (D(a) − 1) / κ, shape (B, A)."""
        weights = self.prior / self.partition(q)
        gradient = (weights[:, None] @ self.kernel).squeeze(1) / self.scale
        return gradient - (q * gradient).sum(1, keepdim=True)

    def curvature(self, q: Tensor) -> Tensor:
        """Negative Hessian of h, shape (B, A, A)."""
        rows = self.kernel * (self.prior.sqrt() / self.partition(q))[..., None]
        return rows.mT @ rows / self.scale[..., None]

    def value(self, q: Tensor) -> Tensor:
        """h(q), shape (B, 1)."""
        inner = (self.kernel @ q[..., None]).squeeze(-1)
        logs = torch.where(self.small, inner.log1p(), inner.log())
        return (logs * self.prior).sum(1, keepdim=True) / self.scale


def _solve_one_channel(utilities: Tensor, prior: Tensor, beta: Tensor) -> _OneChannel:
    """One-channel optimum for every price of a batch: utilities (W, A), prior (W,), beta (B,)."""
    mixture = _Mixture(utilities, prior, beta)
    q, slope_excess, iterations = _maximise(mixture)
    unit = mixture.scale.squeeze(1) / beta
    centred, offset = _centre(utilities, prior)
    headroom = (mixture.scale * slope_excess).squeeze(1).log1p() / beta
    upper_bound = unit * mixture.value(q).squeeze(1) + headroom

    channel = torch.softmax(q.log()[:, None] + beta[:, None, None] * centred, -1)
    expected_utility = torch.einsum("w,bwa,wa->b", prior, channel, centred)
    information = mutual_information(prior, channel)
    objective = expected_utility - information / beta
    return _OneChannel(
        objective=objective + offset,
        expected_utility=expected_utility + offset,
        information=information,
        channel=channel,
        marginal=torch.einsum("w,bwa->ba", prior, channel),
        gap=(upper_bound - objective).clamp(min=0.0),
        iterations=iterations,
        converged=slope_excess.squeeze(1) <= GAP_TOLERANCE,
    )


def _maximise(mixture: _Mixture) -> tuple[Tensor, Tensor, Tensor]:
    """Maximise h over distributions q by Mehrotra's predictor-corrector method.

    With slacks z(a) ≥ 0 the optimum is where ∇h(q) + z is constant over actions, q(a) z(a) = 0 and
    q sums to one. Each step solves these equations, linearised, for q(a) z(a) = μ, and μ falls.

    Returns:
        q (B, A), its certificate max_a (D(a) − 1) / κ (B, 1), and the number of steps (B,).
    """
    cells, _, actions = mixture.kernel.shape
    q = torch.full((cells, actions), 1 / actions, dtype=torch.float64)
    slope = mixture.slope(q)
    z = 1 + slope.amax(1, keepdim=True) - slope
    best, best_gap = q, torch.full((cells, 1), math.inf, dtype=torch.float64)
    running = torch.ones(cells, 1, dtype=torch.bool)
    iterations = torch.zeros(cells, dtype=torch.int64)
    for _ in range(NEWTON_CAP):
        slope = mixture.slope(q)
        gap = slope.amax(1, keepdim=True)
        # Below the tolerance go on for as long as it pays: where J is flat, a smaller gap is what
        # makes E[U] and the information right.
        stalled = (best_gap <= GAP_TOLERANCE) & (gap > best_gap / 2)
        best, best_gap = torch.where(gap < best_gap, q, best), torch.minimum(gap, best_gap)
        running &= ~stalled & (best_gap > 4 * _EPSILON)
        if not running.any():
            break
        iterations += running.squeeze(1)
        next_q, next_z = _newton_step(q, z, slope, mixture.curvature(q))
        q, z = torch.where(running, next_q, q), torch.where(running, next_z, z)
    return best, best_gap, iterations


def _newton_step(q: Tensor, z: Tensor, slope: Tensor, curvature: Tensor) -> tuple[Tensor, Tensor]:
    """One predictor-corrector step from (q, z), both (B, A), towards the optimum."""
    # Scaled by q/z from both sides the system is I plus a positive matrix. The small number keeps
    # it solvable in floating point when duplicate actions make the curvature singular.
    width = (z / q + 64 * _EPSILON).rsqrt()
    system = width[:, :, None] * curvature * width[:, None, :]
    system.diagonal(dim1=1, dim2=2).add_(1.0)
    factor, _ = torch.linalg.cholesky_ex(system)

    def solve(right: Tensor) -> Tensor:
        return width * torch.cholesky_solve((width * right)[..., None], factor).squeeze(-1)

    uniform = solve(torch.ones_like(q))

    def direction(complement: Tensor) -> tuple[Tensor, Tensor]:
        """Step that brings q z to `complement`, to first order, and keeps the sum of q."""
        free = solve(slope + complement / q)
        dq = free - uniform * free.sum(1, keepdim=True) / uniform.sum(1, keepdim=True)
        return dq, (complement - z * dq) / q - z

    mu = (q * z).mean(1, keepdim=True)
    dq, dz = direction(torch.zeros_like(q))
    reached = (q + _longest(q, dq) * dq) * (z + _longest(z, dz) * dz)
    centring = (reached.mean(1, keepdim=True) / mu) ** 3
    dq, dz = direction(centring * mu - dq * dz)
    q = q + 0.995 * _longest(q, dq) * dq
    z = z + 0.995 * _longest(z, dz) * dz
    return q / q.sum(1, keepdim=True), z


def _longest(value: Tensor, step: Tensor) -> Tensor:
    """Largest fraction, up to one, of a step that keeps values non-negative, shape (B, 1)."""
    return torch.where(step < 0, -value / step, math.inf).amin(1, keepdim=True).clamp(max=1.0)


# Two channels in series


@dataclass(frozen=True)
class _Chain:
    """The serial problem for a batch of N climbs.

    A point of a climb is a row (V, log p(x), log p(a)) of length X·A + X + A, where V(x,a) is what
    percept x believes action a to be worth, E[U|x]. It determines p(a|x) ∝ p(a) e^{β₂V(x,a)}, and
    through it p(x|ω) ∝ p(x) e^{β₁ΔF(ω,x)}. In these coordinates any real number is admissible, so
    that points can be extrapolated.
    """

    utilities: Tensor  # (W, A)
    prior: Tensor  # (W,)
    percepts: int
    beta_1: Tensor  # (N,)
    beta_2: Tensor  # (N,)

    def select(self, keep: Tensor) -> "_Chain":
        """The same problem for some of the climbs."""
        return replace(self, beta_1=self.beta_1[keep], beta_2=self.beta_2[keep])

    def tolerance(self) -> Tensor:
        """Largest certified gap of a climb that has converged, shape (N,)."""
        # Sums of probabilities are known to a few ε, and what they certify to a few ε/β.
        rounding = 16 * _EPSILON * (1 / self.beta_1 + 1 / self.beta_2)
        return CLIMB_TOLERANCE * -self.utilities[self.prior > 0].amin() + rounding

    def split(self, point: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """V (N, X, A), log p(x) (N, X), log p(a) (N, A)."""
        actions = self.utilities.shape[1]
        beliefs = point[:, : self.percepts * actions].view(-1, self.percepts, actions)
        return beliefs, point[:, -self.percepts - actions : -actions], point[:, -actions:]

    def act(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """p(a|x) (N, X, A), and the free utility ΔF(ω,x) as (N, X, W)."""
        beliefs, _, log_action = self.split(point)
        log_action = log_action[:, None]
        log_rows = torch.addcmul(log_action, self.beta_2[:, None, None], beliefs).log_softmax(2)
        action = log_rows.exp()
        cost = (action * (log_rows - log_action)).sum(2, keepdim=True) / self.beta_2[:, None, None]
        expected = action.flatten(0, 1) @ self.utilities.mT
        return action, expected.view(*action.shape[:2], -1) - cost

    def perceive(self, point: Tensor, free_utility: Tensor) -> tuple[Tensor, Tensor]:
        """p(x|ω) as (N, X, W), and log Z(ω) (N, W)."""
        log_percept = self.split(point)[1][..., None]
        logits = torch.addcmul(log_percept, self.beta_1[:, None, None], free_utility)
        highest = logits.amax(1, keepdim=True)
        weights = (logits - highest).exp()
        partition = weights.sum(1, keepdim=True)
        return weights / partition, (highest + partition.log()).squeeze(1)

    def sweep(self, point: Tensor) -> "_Sweep":
        """One round of the self-consistent equations."""
        action, free_utility = self.act(point)
        perception, log_partition = self.perceive(point, free_utility)
        joint = perception * self.prior
        percept = joint.sum(2)
        beliefs = (joint.flatten(0, 1) @ self.utilities).view(*percept.shape, -1)
        # A percept that no state can reach any more keeps its beliefs.
        beliefs = torch.where(
            percept[..., None] > _PERCEPT_FLOOR, beliefs / percept[..., None], self.split(point)[0]
        )
        marginal = (percept[:, None] @ action).squeeze(1)
        return _Sweep(
            point=_point(beliefs, percept, marginal),
            objective=log_partition @ self.prior / self.beta_1,
            action=action,
            percept=percept,
        )

    def gap(self, point: Tensor, sweep: "_Sweep") -> Tensor:
        """What either block could still gain (see `serial`), for a point that a sweep ended in."""
        _, log_percept, log_action = self.split(point)
        percept_growth = sweep.percept / log_percept.exp()
        action_growth = (log_percept.exp()[:, None] @ sweep.action).squeeze(1) / log_action.exp()
        return (
            percept_growth.amax(1).log() / self.beta_1 + action_growth.amax(1).log() / self.beta_2
        )

    def extrapolate(
        self, start: Tensor, first: Tensor, second: Tensor, limit: Tensor
    ) -> tuple[Tensor, Tensor]:
        """SQUAREM: the point that two sweeps seem to lead to, and the step length (N,).

        The length is measured in logits weighted by probability: what hardly ever happens should
        not set the step.
        """
        change = first - start
        bend = second - first - change
        _, log_percept, log_action = self.split(first)
        percept, action = log_percept.exp(), log_action.exp()
        joint = percept[..., None] * action[:, None] * self.beta_2[:, None, None].square()
        weight = torch.cat((joint.flatten(1), percept, action), 1)
        bent = (weight * bend.square()).sum(1).clamp(min=_TINY)
        length = ((weight * change.square()).sum(1) / bent).sqrt().clamp(min=1.0)
        length = torch.minimum(length, limit)
        t = length[:, None]
        beliefs, log_percept, log_action = self.split(start + 2 * t * change + t.square() * bend)
        logs = (beliefs.flatten(1), log_percept.log_softmax(1), log_action.log_softmax(1))
        return torch.cat(logs, 1), length

    def renew(self, point: Tensor) -> Tensor:
        """Give both blocks the marginals that are best for them, by Newton steps.

        Sweeps move log p(x) and log p(a) by at most β₁ and β₂ times the span of the utilities;
        where one price is small and the other large they would take millions.
        """
        beliefs, log_percept, _ = self.split(point)
        action, _, _ = _maximise(_Mixture(beliefs, log_percept.exp(), self.beta_2))
        point = _point(beliefs, log_percept.exp(), action)
        _, free_utility = self.act(point)
        percept, _, _ = _maximise(_Mixture(free_utility.mT, self.prior, self.beta_1))
        return _point(beliefs, percept, action)


def _point(beliefs: Tensor, percept: Tensor, action: Tensor) -> Tensor:
    """Point of a climb (see `_Chain`) from V (N, X, A), p(x) (N, X) and p(a) (N, A)."""
    marginals = (percept.clamp(min=_PERCEPT_FLOOR), action.clamp(min=_ACTION_FLOOR))
    return torch.cat((beliefs.flatten(1), *(p.log() for p in marginals)), 1)


class _Sweep(NamedTuple):
    point: Tensor  # (N, X·A + X + A), after the sweep
    objective: Tensor  # (N,), J before the marginals were renewed
    action: Tensor  # p(a|x) that the sweep began with, (N, X, A)
    percept: Tensor  # p(x) after the sweep, (N, X)


class _Climb(NamedTuple):
    point: Tensor  # (N, X·A + X + A)
    gap: Tensor  # (N,)
    sweeps: Tensor  # (N,)
    converged: Tensor  # (N,)


def _climb(chain: _Chain, start: Tensor) -> _Climb:
    """Run every climb of the batch until its certificate meets the tolerance."""
    count = len(start)
    # The start's beliefs are arbitrary; after one sweep they are expectations, as the certificate
    # requires.
    point = chain.sweep(start).point
    finished = _Climb(
        point=torch.empty_like(point),
        gap=torch.empty(count, dtype=torch.float64),
        sweeps=torch.empty(count, dtype=torch.int64),
        converged=torch.empty(count, dtype=torch.bool),
    )
    tolerance = chain.tolerance()
    limit = torch.full((count,), _FIRST_LIMIT, dtype=torch.float64)
    running = torch.arange(count)
    for cycle in itertools.count(1):
        first = chain.sweep(point)
        gap = chain.gap(point, first)
        converged = gap <= tolerance
        leaving = converged | (3 * cycle >= SWEEP_CAP)
        if leaving.any():
            left, keep = running[leaving], ~leaving
            finished.point[left] = point[leaving]
            finished.gap[left] = gap[leaving]
            finished.sweeps[left] = 3 * cycle - 1
            finished.converged[left] = converged[leaving]
            if not keep.any():
                break
            running, limit, tolerance = running[keep], limit[keep], tolerance[keep]
            chain, point = chain.select(keep), point[keep]
            first = _Sweep(*(field[keep] for field in first))
        if cycle % _RENEWAL == 0:
            point = chain.sweep(chain.renew(first.point)).point
            continue
        second = chain.sweep(first.point)
        candidate, length = chain.extrapolate(point, first.point, second.point, limit)
        third = chain.sweep(candidate)
        risen = third.objective >= second.objective
        point = torch.where(risen[:, None], third.point, second.point)
        reached = torch.where(length >= limit, 4 * limit, limit)
        limit = torch.where(risen, reached, (limit / 2).clamp(min=2.0))
    return finished


def _starts(chain: _Chain, one_channel: Tensor, restarts: int, seed: int) -> Tensor:
    """Starting points (N, X·A + X + A): the same draws for every pair of prices.

    The first is the diagonal start of Genewein et al. (2015), in which each percept believes in
    its own share of the states. Then follow, in turn,

    * percepts that stand for the actions which the disturbed one-channel optimum uses most,
    * covering starts, in which the percepts share out a random part of the actions,
    * perceptions at random, from vague to sharp.

    None of the kinds is best for all utilities and prices.

    Args:
        chain: The problem.
        one_channel: Optimal p(a|ω) of one channel for each pair of prices, (cells, W, A).
        restarts: Number of starts for each pair of prices.
        seed: Seed of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    cells, states, actions = one_channel.shape
    percepts = chain.percepts

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    def uniform() -> Tensor:
        return torch.rand((), generator=generator, dtype=torch.float64)

    # Percepts beyond the number of actions begin as copies.
    copies = torch.arange(percepts) % actions
    log_channel = one_channel.clamp(min=_ACTION_FLOOR).log()
    preference_scale = 1 / chain.beta_2.view(cells, restarts)[:, 0, None, None]

    distance = torch.arange(states)[:, None] - torch.arange(percepts)
    diagonal = (distance % min(states, percepts) == 0).double()
    beliefs = [_expected_utility(chain, diagonal).expand(cells, -1, -1)]
    for restart in range(1, restarts):
        if restart % 3 == 1:
            disturbed = (log_channel + 3 * uniform() * noise(states, actions)).softmax(2)
            usage = chain.prior @ disturbed
            order = usage.argsort(dim=1, descending=True, stable=True)[:, copies, None]
            worth = _expected_utility(chain, disturbed)
            beliefs.append(worth.gather(1, order.expand(-1, -1, actions)))
        elif restart % 3 == 2:
            chosen = torch.randperm(actions, generator=generator)[: 1 + int(uniform() * actions)]
            favourite = chosen[torch.arange(percepts) % len(chosen)]
            preference = 5 * torch.nn.functional.one_hot(favourite, actions)
            beliefs.append((preference + noise(percepts, actions)) * preference_scale)
        else:
            perception = (10 * uniform() * noise(states, percepts)).softmax(1)
            beliefs.append(_expected_utility(chain, perception).expand(cells, -1, -1))
    stacked = torch.stack(beliefs, 1).flatten(0, 1)
    ones = torch.ones(len(stacked), percepts + actions, dtype=torch.float64)
    return _point(stacked, ones[:, :percepts] / percepts, ones[:, percepts:] / actions)


def _expected_utility(chain: _Chain, channel: Tensor) -> Tensor:
    """E[U|y] (..., Y, A) for a channel p(y|ω) (..., W, Y); states without mass barely count."""
    joint = channel * (chain.prior[:, None] + _TINY)
    return (joint / joint.sum(-2, keepdim=True)).mT @ chain.utilities


class _Terms(NamedTuple):
    objective: Tensor
    expected_utility: Tensor
    perception_information: Tensor
    action_information: Tensor
    end_to_end_information: Tensor
    action_given_state: Tensor
    percept_given_state: Tensor
    action_given_percept: Tensor
    percept_marginal: Tensor
    action_marginal: Tensor


def _score(chain: _Chain, point: Tensor) -> _Terms:
    """J and its terms for the channels at a point, with their own marginals."""
    action, free_utility = chain.act(point)
    perception = chain.perceive(point, free_utility)[0].mT
    percept_marginal = chain.prior @ perception
    behaviour = perception @ action
    expected_utility = torch.einsum("w,nwa,wa->n", chain.prior, behaviour, chain.utilities)
    perception_information = mutual_information(chain.prior, perception)
    action_information = mutual_information(percept_marginal, action)
    return _Terms(
        objective=expected_utility
        - perception_information / chain.beta_1
        - action_information / chain.beta_2,
        expected_utility=expected_utility,
        perception_information=perception_information,
        action_information=action_information,
        end_to_end_information=mutual_information(chain.prior, behaviour),
        action_given_state=behaviour,
        percept_given_state=perception,
        action_given_percept=action,
        percept_marginal=percept_marginal,
        action_marginal=(percept_marginal[:, None] @ action).squeeze(1),
    )


# What goes in and out


def _centre(utilities: Tensor, prior: Tensor) -> tuple[Tensor, Tensor]:
    """Utilities less each state's best one, and the expectation of what was taken away."""
    best = utilities.amax(1, keepdim=True)
    return utilities - best, prior @ best.squeeze(1)


def _check_problem(utilities: ArrayLike, prior: ArrayLike | None) -> tuple[Tensor, Tensor]:
    """Utilities (W, A) and prior (W,), as float64."""
    table = _numbers(utilities, "utilities")
    if table.ndim != 2 or table.numel() == 0:
        raise ValueError(
            f"utilities: got shape {tuple(table.shape)}, expected a table with one row for each "
            "world-state and one column for each action"
        )
    if not table.isfinite().all():
        raise ValueError(
            "utilities: got NaN or infinity, expected finite numbers; "
            "give an action that must not be taken a large negative utility"
        )
    states = len(table)
    if prior is None:
        return table, torch.full((states,), 1 / states, dtype=torch.float64)
    p = _numbers(prior, "prior")
    if p.shape != (states,):
        raise ValueError(
            f"prior: got shape {tuple(p.shape)}, expected ({states},), one probability for each "
            "row of utilities; None stands for the uniform prior"
        )
    if not (p >= 0).all():
        raise ValueError(
            f"prior: got {p.min().item():g}, expected probabilities, which are not negative"
        )
    # Sums of float32 probabilities are off by some 1e-7.
    if abs(p.sum().item() - 1) > 1e-6:
        raise ValueError(
            f"prior: got probabilities that sum to {p.sum().item():g}, expected 1; "
            "divide them by their sum"
        )
    return table, p / p.sum()


def _check_price(beta: float | ArrayLike, name: str) -> Tensor:
    """Prices of any shape, as float64."""
    prices = _numbers(beta, name)
    refused = ~((prices > 0) & prices.isfinite())
    if refused.any() or prices.numel() == 0:
        got = f"{prices[refused][0].item():g}" if prices.numel() else "no number"
        raise ValueError(
            f"{name}: got {got}, expected a finite number above 0; "
            "a large one stands for free information, a small one for none"
        )
    return prices


def _broadcast(beta_1: Tensor, beta_2: Tensor) -> tuple[Tensor, Tensor]:
    """Both prices in their common shape."""
    try:
        shape = (beta_1 + beta_2).shape
    except RuntimeError as error:
        raise ValueError(
            f"beta_perception and beta_action: got shapes {tuple(beta_1.shape)} and "
            f"{tuple(beta_2.shape)}, expected shapes that broadcast against each other"
        ) from error
    return beta_1.expand(shape), beta_2.expand(shape)


def _check_count(count: int, name: str) -> None:
    """Refuse what is not a positive integer."""
    if isinstance(count, bool) or not hasattr(count, "__index__"):
        raise TypeError(f"{name}: got {count!r}, expected an integer of at least 1")
    if count < 1:
        raise ValueError(f"{name}: got {count}, expected an integer of at least 1")


def _numbers(values: float | ArrayLike, name: str) -> Tensor:
    """Values as a float64 tensor that belongs to no graph."""
    try:
        return torch.as_tensor(values, dtype=torch.float64, device="cpu").detach()
    except (TypeError, ValueError, RuntimeError) as error:
        kind = ValueError if isinstance(error, ValueError) else TypeError
        raise kind(
            f"{name}: got {' '.join(repr(values).split()):.60}, expected numbers: a tensor, an "
            "array, or lists of equal length"
        ) from error


def _shaped(values: Tensor, shape: torch.Size) -> Any:
    """One value for each price; a Python number where the price was one."""
    return values.reshape(shape) if shape else values.item()


def _warn_cap(solver: str, converged: Tensor, cap: str, gap: Tensor) -> None:
    """Warn, in the name of the caller's caller, that some solves were cut short."""
    open_solves = ~converged
    warnings.warn(
        f"{solver}: {int(open_solves.sum())} of {len(converged)} solves did not converge within "
        f"{cap}; the largest certified gap left is {gap[open_solves].max().item():.1e}",
        stacklevel=3,
    )
