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
_EVEN = 1e-4
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
    leaves: list[Integers]
    """Cells that cover the simplex, for each."""


class _Cells(NamedTuple):
    """N cells, and what was found of them for some c and g."""

    vertices: Floats  # (N, K, K), one a row
    weights: Floats  # θ, (N, K)
    linear: Floats  # c, (N, K)
    log_weights: Floats  # g, (N, Y)
    bound: Floats  # (N,)
    least: Floats  # of μ, (N, Y)
    most: Floats  # of μ, (N, Y)
    edge: Integers  # to halve, (N, 2)

    def select(self, keep: NDArray[np.bool_] | Integers | slice) -> "_Cells":
        return _Cells(*(column[keep] for column in self))


class Envelope:
    """Cells of the simplex, which bounds for one pair of c and g leave to those for the next."""

    def __init__(self, landscape: Landscape) -> None:
        self.landscape = landscape
        corners, outcomes = landscape.table.shape
        self._cells = _Cells(
            np.eye(corners)[None],
            np.full((1, corners), 1 / corners),
            np.zeros((1, corners)),
            np.zeros((1, outcomes)),
            np.full(1, np.inf),
            np.zeros((1, outcomes)),
            np.ones((1, outcomes)),
            np.zeros((1, 2), dtype=np.int64),
        )
        self._size = 1

    @property
    def simplex(self) -> Integers:
        """The cell of all points."""
        return np.zeros(1, dtype=np.int64)

    def _remember(self, cells: _Cells) -> Integers:
        """Their numbers."""
        begin, end = self._size, self._size + len(cells.bound)
        room = len(self._cells.bound)
        if end > room:
            self._cells = _Cells(
                *(np.concatenate((c, np.empty((end, *c.shape[1:]), c.dtype))) for c in self._cells)
            )
        for column, rows in zip(self._cells, cells, strict=True):
            column[begin:end] = rows
        self._size = end
        return np.arange(begin, end)

    def largest(
        self,
        linear: Floats,
        log_weights: Floats,
        leaves: list[Integers],
        enough: Floats,
        cells: Integers,
        deadline: float,
    ) -> Largest:
        count, corners = linear.shape
        problem = np.repeat(np.arange(count), [len(some) for some in leaves])
        known = np.concatenate(leaves)
        estimate = self._transferred(known, linear[problem], log_weights[problem])
        bound, value = np.full((2, count), -np.inf)
        point = np.full((count, corners), 1 / corners)
        done_problem, done_cells = [], []
        go = estimate > enough[problem]
        np.maximum.at(bound, problem[~go], estimate[~go])
        done_problem.append(problem[~go]); done_cells.append(known[~go])
        live = self._cells.select(known[go])
        problem = problem[go]
        live = live._replace(bound=estimate[go], linear=linear[problem], log_weights=log_weights[problem])
        while len(problem):
            live, inside, heights = _examined(self.landscape, live, enough[problem])
            cells = cells - np.bincount(problem, minlength=count)
            order = heights.argsort()
            last = np.full(count, -1)
            last[problem[order]] = order  # of several the last, which is the highest
            better = np.flatnonzero((last >= 0) & (heights[last] > value))
            value[better], point[better] = heights[last[better]], inside[last[better]]
            split = (live.bound > enough[problem]) & (value <= enough)[problem]
            split &= (cells > 0)[problem] & (time.monotonic() <= deadline)
            np.maximum.at(bound, problem[~split], live.bound[~split])
            done_problem.append(problem[~split])
            done_cells.append(self._remember(live.select(~split)))
            live = _halved(live.select(split))
            problem = np.concatenate((problem[split],) * 2)
        problem, known = np.concatenate(done_problem), np.concatenate(done_cells)
        order = problem.argsort(kind="stable")
        ends = np.bincount(problem, minlength=count).cumsum()[:-1]
        return Largest(bound, value, point, np.split(known[order], ends))

    def _transferred(self, known: Integers, linear: Floats, log_weights: Floats) -> Floats:
        """Bounds of cells for c and g, from those for other c and g."""
        cells = self._cells.select(known)
        change = linear - cells.linear
        rise = (cells.vertices @ change[..., None])[..., 0].max(1)
        delta = log_weights - cells.log_weights
        middle = np.sqrt(cells.least * cells.most)
        middle /= np.maximum(middle.sum(1, keepdims=True),_TINY)
        pivot = (middle * delta).sum(1, keepdims=True)
        growth = np.expm1(delta - pivot)
        growth = np.where(growth > 0, cells.most, cells.least) * growth
        rise += (pivot[:, 0] + np.log1p(np.maximum(growth.sum(1), -1 + 1e-12))) / self.landscape.sharpness
        return cells.bound + rise


def _examined(
    landscape: Landscape, live: _Cells, enough: Floats
) -> tuple[_Cells, Floats, Floats]:
    """Cells with their bounds, a point in each (N, K), F there (N,)."""
    size = max(1, _ROOM // (live.vertices.shape[1] * max(landscape.table.shape)))
    parts = []
    for begin in range(0, len(live.bound), size):
        piece = slice(begin, begin + size)
        parts.append(_bounded(landscape, live.select(piece), enough[piece]))
    if len(parts) == 1:
        return parts[0]
    cells, inside, heights = zip(*parts)
    return _Cells(*(np.concatenate(c) for c in zip(*cells))), np.concatenate(inside), np.concatenate(heights)


def _bounded(
    landscape: Landscape, cells: _Cells, enough: Floats
) -> tuple[_Cells, Floats, Floats]:
    """Bound, θ, the point that it stands for, F there, and the edge to halve, of each cell."""
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


def _halved(cells: _Cells) -> _Cells:
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
