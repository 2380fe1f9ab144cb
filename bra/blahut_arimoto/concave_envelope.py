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
"""

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Newton steps for one cell, and the numbers in one table of the cells that are looked at together.
_STEPS, _ROOM = 12, 2**18
# Probabilities below count as that in D, which bounds M, and in logarithms.
_COARSE, _TINY = 1e-2, 1e-200
# Of eigenvalues, relative to the largest: more than their rounding.
_ROUNDING = 1e-12


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


class Largest(NamedTuple):
    """max F for each of n pairs of c and g."""

    bound: Floats
    """No F is larger, (n,)."""
    value: Floats
    """F at the best point found, (n,)."""
    point: Floats
    """That point, (n, K)."""


class _Cells(NamedTuple):
    """N cells of all problems."""

    vertices: Floats  # (N, K, K), one a row
    weights: Floats  # θ, (N, K)
    problem: Integers  # (N,)
    bound: Floats  # (N,)

    def select(self, keep: NDArray[np.bool_] | slice) -> "_Cells":
        vertices, weights, problem, bound = self
        return _Cells(vertices[keep], weights[keep], problem[keep], bound[keep])


def largest(
    landscape: Landscape,
    linear: Floats,
    log_weights: Floats,
    enough: Floats,
    cells: Integers,
    deadline: float,
) -> Largest:
    """Bounds on max F that are pursued until they are small enough, or a larger F is found.

    Args:
        landscape: T, τ and b.
        linear: c, (n, K).
        log_weights: g, (n, Y).
        enough: Bounds as small as that need not be smaller, (n,).
        cells: How many may be looked at for each, (n,).
        deadline: When to stop, of `time.monotonic`.
    """
    count, corners = linear.shape
    simplex = np.broadcast_to(np.eye(corners), (count, corners, corners))
    centre = np.full((count, corners), 1 / corners)
    live = _Cells(simplex, centre, np.arange(count), np.full(count, np.inf))
    bound, value = np.full((2, count), -np.inf)
    point = centre.copy()
    while True:
        live, inside, heights, edge = _examined(landscape, live, linear, log_weights, enough)
        cells = cells - np.bincount(live.problem, minlength=count)
        order = heights.argsort()
        last = np.full(count, -1)
        last[live.problem[order]] = order  # of several the last, which is the highest
        better = np.flatnonzero((last >= 0) & (heights[last] > value))
        value[better], point[better] = heights[last[better]], inside[last[better]]
        split = (live.bound > enough[live.problem]) & (value <= enough)[live.problem]
        split &= (cells > 0)[live.problem] & (time.monotonic() <= deadline)
        np.maximum.at(bound, live.problem[~split], live.bound[~split])
        if not split.any():
            return Largest(bound, value, point)
        live = _halved(live.select(split), edge[split])


def _examined(
    landscape: Landscape, live: _Cells, linear: Floats, log_weights: Floats, enough: Floats
) -> tuple[_Cells, Floats, Floats, Integers]:
    """Cells with their bounds, a point in each (N, K), F there (N,), the edge to halve (N, 2)."""
    size = max(1, _ROOM // (live.vertices.shape[1] * max(landscape.table.shape)))
    parts = []
    for begin in range(0, len(live.problem), size):
        part = live.select(slice(begin, begin + size))
        c, g = linear[part.problem], log_weights[part.problem]
        parts.append(_bounded(landscape, part, c, g, enough[part.problem]))
    bound, weights, inside, heights, edge = (
        np.concatenate(rows) for rows in zip(*parts, strict=True)
    )
    return live._replace(bound=bound, weights=weights), inside, heights, edge


def _bounded(
    landscape: Landscape, cells: _Cells, linear: Floats, log_weights: Floats, enough: Floats
) -> tuple[Floats, Floats, Floats, Floats, Integers]:
    """Bound, θ, the point that it stands for, F there, and the edge to halve, of each cell."""
    vertices, price = cells.vertices, landscape.entropy_price
    convex, softmax = landscape.softmax(vertices, log_weights[:, None])
    inside = (cells.weights[:, None] @ vertices)[:, 0]
    paid = landscape.paid_convexity(vertices, inside, softmax)
    gram = vertices @ paid @ _turned(vertices)
    heights = convex + (vertices @ linear[..., None])[..., 0]
    bound, weights = _concave_maximum(
        vertices, heights / price, gram / price, cells.weights, cells.bound / price, enough / price
    )
    inside = (weights[:, None] @ vertices)[:, 0]
    here, softmax = landscape.softmax(inside, log_weights)
    entropy = (inside * np.log(np.maximum(inside, _TINY))).sum(1)
    value = here + (linear * inside).sum(1) - price * entropy
    rows = vertices @ landscape.table
    rows = rows - rows @ softmax[..., None]
    rows *= np.sqrt(landscape.sharpness * softmax)[:, None]
    return price * bound, weights, inside, value, _edge(rows @ _turned(rows) - gram, weights)


def _edge(curvature: Floats, weights: Floats) -> Integers:
    """The two vertices (N, 2) between which the interpolation loses most at the point inside.

    Args:
        curvature: Gram matrix of the vertices under the curvature that M does not pay, (N, K, K).
        weights: θ, (N, K).
    """
    first, second = np.triu_indices(weights.shape[1], 1)
    square = curvature.diagonal(axis1=1, axis2=2)
    loss = square[:, first] + square[:, second] - 2 * curvature[:, first, second]
    chosen = (loss * (weights[:, first] * weights[:, second] + 1e-4)).argmax(1)
    return np.stack((first[chosen], second[chosen]), 1)


def _halved(cells: _Cells, edge: Integers) -> _Cells:
    """Both halves of every cell, with θ near the same point."""
    each, halves = np.arange(len(edge)), []
    for moved, kept in (edge.T, edge.T[::-1]):
        vertices, weights = cells.vertices.copy(), cells.weights.copy()
        vertices[each, moved] = (vertices[each, moved] + vertices[each, kept]) / 2
        weights[each, kept] = np.maximum(weights[each, kept] - weights[each, moved], 0)
        weights[each, moved] *= 2
        weights += 0.05 / weights.shape[1]
        weights /= weights.sum(1, keepdims=True)
        halves.append(cells._replace(vertices=vertices, weights=weights))
    return _Cells(*(np.concatenate(columns) for columns in zip(*halves, strict=True)))


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
