"""The concave problem behind every Blahut-Arimoto step, solved by Newton's method.

For fixed utilities and price the best channel p(a|ω) = q(a) e^{βU(ω,a)} / Z(ω) is known up to its
marginal q, and q maximises

    G(q) = (1/β) Σ_ω p(ω) log Z(ω),  Z(ω) = Σ_a q(a) e^{βU(ω,a)},

the log-likelihood of mixture proportions q. Blahut-Arimoto climbs it by q(a) ← q(a) D(a) with
D(a) = Σ_ω p(ω) e^{βU(ω,a)} / Z(ω), which is the EM algorithm and takes arbitrarily many steps where
an action is about to enter the support. Newton steps (Mehrotra's primal-dual interior-point
method) take ten to twenty anywhere. Every q certifies G* − G(q) ≤ (1/β) log max_a D(a).

Most of many actions have no part in the optimum. A few dozen gradient steps tell which may have
one, Newton steps run among these, and the certificate says whether others have to join them.
"""

import copy
from typing import NamedTuple

import torch
from torch import Tensor

# Certificates at which a solve has converged, in units of the likelihood.
GAP_TOLERANCE = 1e-12
NEWTON_CAP = 100

# So many actions at least before some are left out, what these keep, and steps towards the choice.
_MANY, _LEFT_OUT, _STEPS = 64, 1e-20, 8
# Share of the likeliest action's probability that makes an action worth a Newton step.
_WORTH = 1e-2
# Z − 1 above which Z counts as near one.
_NEAR = -0.5
# Share of the way to the boundary that steps leave: as little as μ, within these bounds.
_MARGIN = 1e-8, 5e-3
_EPSILON = torch.finfo(torch.float64).eps


class MixtureLikelihood:
    """The concave function h(q) = (1/κ) Σ_ω p(ω) log Z(ω), for a batch of B problems.

    h is G in units of κ/β = min(R, 1/β), R being what the best single action loses against the best
    one in every state: in these units slopes are of order one at any price, whatever an action may
    cost that nobody takes. Utilities count from each state's best action. Z is held as 1 + M q,
    M = e^{βU} − 1, where it is near one, since there the differences between actions would be lost
    in the rounding of the ones, and else as M q, M = e^{βU}.

    Args:
        utilities: Shape (W, A) or (B, W, A).
        prior: Shape (W,) or (B, W).
        beta: Shape (B,).
    """

    def __init__(self, utilities: Tensor, prior: Tensor, beta: Tensor) -> None:
        centred = utilities - utilities.amax(-1, keepdim=True)
        # A state that never occurs bears no weight.
        exponent = beta[:, None, None] * torch.where(prior[..., None] > 0, centred, 0.0)
        regret = -(prior[..., None, :] @ exponent).squeeze(1).amax(-1, keepdim=True)
        self.scale = torch.where(regret > 0, regret, 1.0).clamp(max=1.0)
        self.kernel = exponent.exp()
        self._excess = exponent.expm1()
        self._weight = prior / self.scale
        self._root = self._weight.sqrt()

    def value(self, q: Tensor) -> Tensor:
        """h(q) for q of shape (B, A), shape (B,)."""
        excess, partition = self._partition(q)
        log = torch.where(excess > _NEAR, excess.clamp(min=_NEAR).log1p(), partition.log())
        return (log * self._weight).sum(1)

    def slope(self, q: Tensor) -> Tensor:
        """Gradient less its mean under q, (D − 1) / κ, (B, A)."""
        excess, partition = self._partition(q)
        near = excess > _NEAR
        by_excess = torch.where(near, self._weight / (1 + excess), 0.0)[:, None] @ self._excess
        by_kernel = torch.where(near, 0.0, self._weight / partition)[:, None] @ self.kernel
        gradient = (by_excess + by_kernel).squeeze(1)
        return gradient - (q * gradient).sum(1, keepdim=True)

    def among(self, actions: Tensor) -> "MixtureLikelihood":
        """The same for some actions (K,), in the same units."""
        few = copy.copy(self)
        few.kernel, few._excess = self.kernel[..., actions], self._excess[..., actions]
        return few

    def derivatives(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """The slope (B, A), and the negative Hessian (B, A, A).

        The Hessian is that of h among distributions: rows of M that differ by a constant are equal.
        """
        excess, partition = self._partition(q)
        near = excess > _NEAR
        rows = torch.where(near[..., None], self._excess, self.kernel)
        rows = rows * (self._root / torch.where(near, 1 + excess, partition))[..., None]
        gradient = (self._root[:, None] @ rows).squeeze(1)
        return gradient - (q * gradient).sum(1, keepdim=True), rows.mT @ rows

    def beginning(self) -> Tensor:
        """Distributions q with hardly anything on actions that are far too costly, (B, A)."""
        loss = -(self._weight[:, None] @ self._excess).squeeze(1)
        return 1 / (1 + loss) / (1 / (1 + loss)).sum(1, keepdim=True)

    def _partition(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Z − 1 and Z, (B, W) each."""
        return (self._excess @ q[..., None]).squeeze(-1), (self.kernel @ q[..., None]).squeeze(-1)


class Maximum(NamedTuple):
    """Where h is largest, and the proof."""

    q: Tensor
    """Distributions, shape (B, A)."""
    certificate: Tensor
    """max_a (D(a) − 1) / κ, shape (B,)."""
    iterations: Tensor
    """Newton steps, shape (B,)."""


def maximise(likelihood: MixtureLikelihood) -> Maximum:
    """Maximise h over distributions q, among few actions first where there are many."""
    if likelihood.kernel.shape[2] < _MANY:
        return _by_newton(likelihood)
    chosen = _promising(likelihood)
    while True:
        found = _by_newton(likelihood.among(chosen.nonzero().squeeze(1)))
        q = torch.full_like(likelihood.kernel[:, 0], _LEFT_OUT)
        q[:, chosen] = found.q
        slope = likelihood.slope(q)
        missing = (slope > GAP_TOLERANCE / 100).any(0) & ~chosen
        if not missing.any():
            certificate = torch.maximum(slope.amax(1), found.certificate)
            return Maximum(q, certificate, found.iterations)
        chosen |= missing


def _promising(likelihood: MixtureLikelihood) -> Tensor:
    """Actions that are likely, or become more so, after bold steps and some of EM, (A,)."""
    q = likelihood.beginning()
    for step in range(2 * _STEPS):
        slope = likelihood.slope(q)
        if step < _STEPS:
            steepest = slope.amax(1, keepdim=True).clamp(min=_EPSILON)
            q = (q.log() + slope / steepest).softmax(1)
        else:
            q = q * (1 + likelihood.scale * slope)
    unlikely = q <= _WORTH * q.amax(1, keepdim=True)  # which NaN, of steps too bold, is not
    return (~unlikely | (likelihood.slope(q) > 0)).any(0)


def _by_newton(likelihood: MixtureLikelihood) -> Maximum:
    """Maximise h by Newton steps.

    With slacks z(a) ≥ 0 the optimum is where ∇h(q) + z is constant over actions, q(a) z(a) = 0 and
    q sums to one. Each step solves these equations, linearised, for q(a) z(a) = μ, and μ falls.
    """
    q = likelihood.beginning()
    slope, curvature = likelihood.derivatives(q)
    gap = slope.amax(1, keepdim=True)
    z = 1 + gap - slope
    best, best_gap = q, gap
    running = best_gap > 4 * _EPSILON
    iterations = torch.zeros(len(q), dtype=torch.int64)
    for _ in range(NEWTON_CAP):
        if not running.any():
            break
        iterations += running.squeeze(1)
        next_q, next_z = _newton_step(q, z, slope, curvature)
        q, z = torch.where(running, next_q, q), torch.where(running, next_z, z)
        slope, curvature = likelihood.derivatives(q)
        gap = slope.amax(1, keepdim=True)
        # Below the tolerance go on for as long as it pays: where J is flat, a smaller gap is what
        # makes E[U] and the information right.
        stalled = (best_gap <= GAP_TOLERANCE) & (gap > best_gap / 2)
        best, best_gap = torch.where(gap < best_gap, q, best), torch.minimum(gap, best_gap)
        running = running & ~stalled & (best_gap > 4 * _EPSILON)
    return Maximum(best, best_gap.squeeze(1), iterations)


def _newton_step(q: Tensor, z: Tensor, slope: Tensor, curvature: Tensor) -> tuple[Tensor, Tensor]:
    """One predictor-corrector step from (q, z), both (B, A), towards the optimum."""
    # Scaled by q/z from both sides the system is I plus a positive matrix. The small number keeps
    # it solvable in floating point when duplicate actions make the curvature singular.
    width = (z / q + 64 * _EPSILON).rsqrt()
    system = width[:, :, None] * curvature * width[:, None, :]
    system.diagonal(dim1=1, dim2=2).add_(1.0)
    factor, _ = torch.linalg.cholesky_ex(system)

    def solve(*right: Tensor) -> tuple[Tensor, ...]:
        columns = width[:, :, None] * torch.stack(right, 2)
        return (width[:, :, None] * torch.cholesky_solve(columns, factor)).unbind(2)

    uphill, uniform = solve(slope, torch.ones_like(q))
    uniform = uniform / uniform.sum(1, keepdim=True)

    # The predictor aims at q z = 0, to first order, and keeps the sum of q.
    dq = uphill - uniform * uphill.sum(1, keepdim=True)
    dz = -z - z * dq / q
    reached = (q + _longest(q, dq) * dq) * (z + _longest(z, dz) * dz)
    mu = (q * z).mean(1, keepdim=True)
    centring = (reached.mean(1, keepdim=True) / mu) ** 3

    # The corrector aims at a common value instead, and counts the predictor's second order.
    inward = (centring * mu - dq * dz) / q
    free = uphill + solve(inward)[0]
    dq = free - uniform * free.sum(1, keepdim=True)
    dz = inward - z - z * dq / q
    share = 1 - mu.clamp(*_MARGIN)
    q = q + share * _longest(q, dq) * dq
    z = z + share * _longest(z, dz) * dz
    return q / q.sum(1, keepdim=True), z


def _longest(value: Tensor, step: Tensor) -> Tensor:
    """Largest fraction, up to one, of a step that keeps values non-negative, shape (B, 1)."""
    return (-step / value).amax(1, keepdim=True).clamp(min=1.0).reciprocal()
