"""The largest value on a simplex of an entropy plus the logarithm of a sum of exponentials.

    F(s) = c·s − τ Σ_k s_k log s_k + (1/b) log Σ_y exp(g_y + b Σ_k s_k T_ky),  s ∈ Δ_K,

is concave plus linear plus convex. It is bounded by branch and bound over simplices with vertices
v_1 … v_K, which are halved at an edge. Call the last term Λ(s), and μ_s(y) ∝ exp(g_y + b s·T_y).

**A part of the convexity that the entropy pays for.** Λ has the Hessian b Cov_μ(s)(T). In a cell
log μ_s(y) = g_y + b s·T_y − b Λ(s) is concave in s, hence μ_s(y) ≥ ν(y) = min_k μ_{v_k}(y), and for
every direction d the variance min_c Σ_y μ_s(y) (d·T_y − c)² is at least that of ν, d·C d. Let M be
a matrix with (i) M ≤ b C and (ii) M ≤ τ diag(1/s) in the whole cell, in the order of quadratic
forms on directions d with Σ d = 0. Then Λ(s) − ½ s·Ms is convex by (i) and lies below its
interpolation between the vertices; ½ s·Ms − τ Σ s log s is concave by (ii) and lies below its
tangent at every s′ > 0. With s = Σ θ_k v_k, θ ∈ Δ, the two sum to Σ_k θ_k t_k(s′), so that

    max F ≤ max_k t_k(s′),  t_k(s′) = c·v_k + Λ(v_k) − ½ (v_k − s′)·M (v_k − s′) − τ v_k·log s′.

The s′ for which this is least maximises a concave function of θ: Newton steps of an interior-point
method find it. Any s′ gives a bound, so that nothing depends on how well they do.

**Which M.** For any positive diagonal D let D b C D = Q w Qᵀ. M = D⁻¹ Q min(w, 1) Qᵀ D⁻¹ meets (i);
with D² = s/τ it would meet (ii) at s. The condition of (ii), that the largest eigenvalue of
diag(√s) M diag(√s) be at most τ, is convex in s and so has to hold at the vertices only: M is
divided by the largest of them, bounded by Frobenius norms of a power, if that is larger. In a small
cell where F is concave, M is all of the curvature, and the bound is tight at once.

**For other c and g.** With c′ and g′ = g + δ the value at s is more by

    (c′ − c)·s + (1/b) log Σ_y μ_s(y) e^{δ_y}.

In a cell the first term is no more than at a vertex. There ν ≤ μ_s. The concave log μ_s(y) lies
below its tangent at s′, so that μ_s(y) ≤ ν̄(y) = μ_{s′}(y) exp(b max_k (v_k − s′)·(T_y − E T)), with
the mean E under μ_{s′}. Hence, for every number t,

    Σ_y μ_s(y) e^{δ_y} ≤ e^t + Σ_y [ν̄(y) max(e^{δ_y} − e^t, 0) − ν(y) max(e^t − e^{δ_y}, 0)],

and what bounds F in the cell for one c and g also does for others, with this added.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Newton steps for one cell.
_STEPS = 12
# What the product of two weights counts as at least, so that cells keep a shape when halved.
_EVEN = 0.1
# Probabilities below count as that in D, which bounds M, and in logarithms.
_COARSE, _TINY = 1e-2, 1e-200
# Of eigenvalues, relative to the largest: more than their rounding.
_ROUNDING = 1e-12
# How much less of a sum of exponentials may be left, less one.
_LEAST_GROWTH = -1 + 1e-12


@dataclass(frozen=True)
class Landscape:
    """F but for c and g, of which there may be many."""

    table: Floats
    """T, (K, Y)."""
    entropy_price: float
    """τ."""
    sharpness: float
    """b."""

    def softmax(self, points: Floats, log_weights: Floats) -> tuple[Floats, Floats]:
        """Λ (N, …) and μ (N, …, Y) at points (N, …, K) for g (N, …, Y)."""
        exponent = log_weights + self.sharpness * (points @ self.table)
        highest = exponent.max(-1, keepdims=True)
        weights = np.exp(exponent - highest)
        total = weights.sum(-1, keepdims=True)
        return (highest + np.log(total))[..., 0] / self.sharpness, weights / total

    def paid_convexity(self, cell: Floats, inside: Floats, softmax: Floats) -> Floats:
        """M (N, K, K) of cells (N, K, K) with points inside (N, K), and μ at vertices (N, K, Y)."""
        least = softmax.min(1)
        mean = least @ self.table.T / np.maximum(least.sum(1, keepdims=True), _TINY)
        rows = (self.table - mean[:, :, None]) * np.sqrt(self.sharpness * least)[:, None]
        rows -= inside[:, None] @ rows  # no difference on directions that sum to zero
        scale = np.sqrt(np.maximum(inside, _COARSE) / self.entropy_price)
        curvature = scale[:, :, None] * (rows @ _turned(rows)) * scale[:, None]
        w, q = np.linalg.eigh(curvature)
        w = np.clip(w - _ROUNDING * np.abs(w).max(1, keepdims=True), 0, 1)
        matrix = (q * w[:, None]) @ _turned(q) / scale[:, :, None] / scale[:, None]
        root = np.sqrt(cell / self.entropy_price)
        power = root[..., None] * matrix[:, None] * root[:, :, None]
        trace = power.trace(axis1=2, axis2=3)
        for _ in range(2):
            power = power @ power
        norm = np.square(power).sum((2, 3)) ** 0.125
        excess = np.minimum(norm, trace).max(1) * (1 + 1e-9)
        paid: Floats = matrix / np.maximum(excess, 1.0)[:, None, None]
        return paid


class Cells(NamedTuple):
    """N cells, and what was found of them for one c and g each."""

    vertices: Floats  # (N, K, K), one a row
    weights: Floats  # θ, (N, K)
    linear: Floats  # c, (N, K)
    log_weights: Floats  # g, (N, Y)
    bound: Floats  # (N,)
    least: Floats  # ν, (N, Y)
    most: Floats  # ν̄, (N, Y)
    edge: Integers  # to halve, (N, 2)

    def select(self, keep: NDArray[np.bool_] | Integers | slice) -> "Cells":
        """Some of them."""
        return Cells._make(column[keep] for column in self)

    @classmethod
    def joined(cls, parts: Sequence["Cells"]) -> "Cells":
        """All cells of these."""
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def transferred(self, linear: Floats, log_weights: Floats, sharpness: float) -> Floats:
        """Bounds (N,) for other c (N, K) and g (N, Y), given b. See the module's text."""
        rise = (self.vertices @ (linear - self.linear)[..., None])[..., 0].max(1)
        change = log_weights - self.log_weights
        typical = np.sqrt(self.least * self.most)
        pivot = (typical * change).sum(1) / np.maximum(typical.sum(1), _TINY)
        growth = np.expm1(change - pivot[:, None])
        growth = (np.where(growth > 0, self.most, self.least) * growth).sum(1)
        rise += (pivot + np.log1p(np.maximum(growth, _LEAST_GROWTH))) / sharpness
        bound: Floats = self.bound + rise
        return bound


def bounded(landscape: Landscape, cells: Cells, enough: Floats) -> tuple[Cells, Floats, Floats]:
    """The cells with their bounds, the points that θ stands for (N, K), and F there (N,)."""
    vertices, price, linear = cells.vertices, landscape.entropy_price, cells.linear
    convex, softmax = landscape.softmax(vertices, cells.log_weights[:, None])
    least = softmax.min(1)
    inside = (cells.weights[:, None] @ vertices)[:, 0]
    paid = landscape.paid_convexity(vertices, inside, softmax)
    gram = vertices @ paid @ _turned(vertices)
    heights = convex + (vertices @ linear[..., None])[..., 0]
    bound, weights = _concave_maximum(
        vertices, heights / price, gram / price, cells.weights, cells.bound / price, enough / price
    )
    inside = (weights[:, None] @ vertices)[:, 0]
    here, softmax = landscape.softmax(inside, cells.log_weights)
    entropy = (inside * np.log(np.maximum(inside, _TINY))).sum(1)
    value = here + (linear * inside).sum(1) - price * entropy
    rows = vertices @ landscape.table
    rows = rows - rows @ softmax[..., None]
    ahead = rows.max(1) - (weights[:, None] @ rows)[:, 0]
    most = np.minimum(softmax * np.exp(np.minimum(landscape.sharpness * ahead, 700)), 1)
    rows *= np.sqrt(landscape.sharpness * softmax)[:, None]
    edge = _edge(rows @ _turned(rows) - gram, weights)
    cells = cells._replace(bound=price * bound, weights=weights, least=least, most=most, edge=edge)
    return cells, inside, value


def _edge(curvature: Floats, weights: Floats) -> Integers:
    """The two vertices (N, 2) between which the interpolation loses most at the point inside.

    Args:
        curvature: Gram matrix of the vertices under the curvature that M does not pay, (N, K, K).
        weights: θ, (N, K).
    """
    first, second = np.triu_indices(weights.shape[1], 1)
    square = curvature.diagonal(axis1=1, axis2=2)
    loss = square[:, first] + square[:, second] - 2 * curvature[:, first, second]
    chosen = (loss * (weights[:, first] * weights[:, second] + _EVEN)).argmax(1)
    return np.stack((first[chosen], second[chosen]), 1)


def halved(cells: Cells) -> Cells:
    """Both halves of every cell, with θ near the same point."""
    edge = cells.edge
    each, halves = np.arange(len(edge)), []
    for moved, kept in (edge.T, edge.T[::-1]):
        vertices, weights = cells.vertices.copy(), cells.weights.copy()
        vertices[each, moved] = (vertices[each, moved] + vertices[each, kept]) / 2
        weights[each, kept] = np.maximum(weights[each, kept] - weights[each, moved], 0)
        weights[each, moved] *= 2
        weights += 0.05 / weights.shape[1]
        weights /= weights.sum(1, keepdims=True)
        halves.append(cells._replace(vertices=vertices, weights=weights))
    return Cells.joined(halves)


def _concave_maximum(
    vertices: Floats, heights: Floats, gram: Floats, weights: Floats, bound: Floats, enough: Floats
) -> tuple[Floats, Floats]:
    """Bounds max_k t_k(s′) (N,), all in units of τ, and θ (N, K) that they were last taken at.

    A cell is left as soon as its bound is small enough, or a point shows that it cannot be.
    """
    bound, weights = bound.copy(), np.maximum(weights, 1e-3)
    running, dual = np.arange(len(bound)), None
    half = gram.diagonal(axis1=1, axis2=2) / 2
    level = heights - half
    for _ in range(_STEPS):
        theta = weights[running] / weights[running].sum(1, keepdims=True)
        weights[running] = theta
        inside = np.maximum((theta[:, None] @ vertices)[:, 0], _TINY)
        pull = (gram @ theta[..., None])[..., 0]
        tangent = level + pull - (vertices @ np.log(inside)[..., None])[..., 0]
        tangent -= (theta * pull).sum(1, keepdims=True) / 2
        mean = (tangent * theta).sum(1)
        top = tangent.max(1)
        bound[running] = np.minimum(bound[running], top)
        left = (bound[running] <= enough) | (mean >= enough)
        if left.all():
            break
        go = ~left
        running, vertices, gram, level, enough = (
            column[go] for column in (running, vertices, gram, level, enough)
        )
        slope, theta = (tangent - mean[:, None])[go], theta[go]
        dual = slope.max(1, keepdims=True) * 1.5 - slope + 1e-3 if dual is None else dual[go]
        curvature = (vertices / inside[go, None]) @ _turned(vertices) - gram
        theta, dual = _newton_step(theta, dual, slope, curvature)
        weights[running] = np.maximum(theta, 1e-12)
    return bound, weights


def _newton_step(
    theta: Floats, dual: Floats, slope: Floats, curvature: Floats
) -> tuple[Floats, Floats]:
    """One predictor-corrector step on the simplex, as in `mixture_likelihood`, for NumPy."""
    width = 1 / np.sqrt(dual / theta + 1e-14)
    system = width[:, :, None] * curvature * width[:, None] + np.eye(theta.shape[1])
    inverse = width[:, :, None] * np.linalg.inv(system) * width[:, None]
    uphill, uniform = (inverse @ slope[..., None])[..., 0], inverse.sum(2)
    uniform = uniform / uniform.sum(1, keepdims=True)
    step = uphill - uniform * uphill.sum(1, keepdims=True)
    change = -dual - dual * step / theta
    reached = (theta + _longest(theta, step) * step) * (dual + _longest(dual, change) * change)
    mu = (theta * dual).mean(1, keepdims=True)
    inward = ((reached.mean(1, keepdims=True) / mu) ** 3 * mu - step * change) / theta
    free = uphill + (inverse @ inward[..., None])[..., 0]
    step = free - uniform * free.sum(1, keepdims=True)
    change = inward - dual - dual * step / theta
    theta = theta + 0.99 * _longest(theta, step) * step
    return theta, dual + 0.99 * _longest(dual, change) * change


def _longest(value: Floats, step: Floats) -> Floats:
    """Largest fraction, up to one, of a step that keeps values non-negative, (N, 1)."""
    fraction: Floats = 1 / np.maximum((-step / value).max(1, keepdims=True), 1.0)
    return fraction


def _turned(matrices: Floats) -> Floats:
    return matrices.swapaxes(1, 2)
