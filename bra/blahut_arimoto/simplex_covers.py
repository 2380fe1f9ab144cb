"""Covers of the simplex by cells, which the bounds for one c and g leave to those for the next.

See `concave_envelope` for F, its bound in a cell, and what the bound becomes for other c and g.
"""

import time
from typing import NamedTuple

import numpy as np

from bra.blahut_arimoto.concave_envelope import (
    Cells,
    Floats,
    Integers,
    Landscape,
    bounded,
    halved,
)

# Numbers in one table of the cells that are looked at together, and cells to make room for.
_ROOM, _MANY = 2**18, 2**12


class Largest(NamedTuple):
    """max F for each of n pairs of c and g."""

    bound: Floats
    """No F is larger, (n,)."""
    value: Floats
    """F at the best point found, −∞ if there was no need to look, (n,)."""
    point: Floats
    """That point, (n, K)."""
    covers: list[Integers]
    """The cells that they were bounded in."""


class Covers:
    """Remembers cells, by number, with what is known of them.

    Args:
        landscape: F but for c and g.
    """

    def __init__(self, landscape: Landscape) -> None:
        self.landscape = landscape
        corners, outcomes = landscape.table.shape
        self._cells = Cells(
            vertices=np.eye(corners)[None],
            weights=np.full((1, corners), 1 / corners),
            linear=np.zeros((1, corners)),
            log_weights=np.zeros((1, outcomes)),
            bound=np.full(1, np.inf),
            least=np.zeros((1, outcomes)),
            most=np.ones((1, outcomes)),
            edge=np.zeros((1, 2), dtype=np.int64),
        )
        self._size = 1
        self._kept = _MANY

    @property
    def simplex(self) -> Integers:
        """The cover by one cell."""
        return np.zeros(1, dtype=np.int64)

    @property
    def crowded(self) -> bool:
        """Whether `forget` is due."""
        return self._size > 2 * self._kept

    def cells(self, cover: Integers) -> Cells:
        """What is known of some cells."""
        return self._cells.select(cover)

    def forget(self, covers: list[Integers]) -> list[Integers]:
        """The same covers, after all cells of no cover, but the simplex, were forgotten."""
        kept = np.unique(np.concatenate((self.simplex, *covers)))
        self._cells = self._cells.select(kept)
        self._size, self._kept = len(kept), max(len(kept), _MANY)
        return [np.searchsorted(kept, cover) for cover in covers]

    def largest(
        self,
        linear: Floats,
        log_weights: Floats,
        covers: list[Integers],
        enough: Floats,
        budget: int,
        deadline: float,
    ) -> Largest:
        """Bounds on max F that are pursued until they are small enough, or a larger F is found.

        Args:
            linear: c, (n, K).
            log_weights: g, (n, Y).
            covers: Cells to begin with, for each of n.
            enough: Bounds as small as that need not be smaller, (n,).
            budget: How many cells may be looked at for each.
            deadline: When to stop, of `time.monotonic`.
        """
        count, corners = linear.shape
        problem = np.repeat(np.arange(count), [len(cover) for cover in covers])
        known = np.concatenate(covers)
        live = self.cells(known)
        c, g = linear[problem], log_weights[problem]
        with np.errstate(all="ignore"):  # a bound that is none fails the comparison
            estimate = live.transferred(c, g, self.landscape.sharpness)
            fails = ~(estimate <= enough[problem])
        bound, value = np.full((2, count), -np.inf)
        point = np.full((count, corners), 1 / corners)
        np.maximum.at(bound, problem[~fails], estimate[~fails])
        settled = [(problem[~fails], known[~fails])]
        infinite = np.full(len(known), np.inf)
        live = live._replace(linear=c, log_weights=g, bound=infinite).select(fails)
        problem, looked = problem[fails], np.zeros(count, dtype=np.int64)
        while len(problem):
            live, inside, heights = self._examined(live, enough[problem])
            looked += np.bincount(problem, minlength=count)
            order = heights.argsort()
            last = np.full(count, -1)
            last[problem[order]] = order  # of several the last, which is the highest
            better = np.flatnonzero((last >= 0) & (heights[last] > value))
            value[better], point[better] = heights[last[better]], inside[last[better]]
            going = (value <= enough) & (looked < budget) & (time.monotonic() <= deadline)
            split = (live.bound > enough[problem]) & going[problem]
            np.maximum.at(bound, problem[~split], live.bound[~split])
            settled.append((problem[~split], self._remember(live.select(~split))))
            live, problem = halved(live.select(split)), np.tile(problem[split], 2)
        return Largest(bound, value, point, _of_each(settled, count))

    def _examined(self, live: Cells, enough: Floats) -> tuple[Cells, Floats, Floats]:
        """As `bounded`, in parts for which there is room."""
        size = max(1, _ROOM // (live.vertices.shape[1] * max(self.landscape.table.shape)))
        pieces = [slice(begin, begin + size) for begin in range(0, len(enough), size)]
        parts = [bounded(self.landscape, live.select(piece), enough[piece]) for piece in pieces]
        cells, inside, heights = zip(*parts, strict=True)
        return Cells.joined(cells), np.concatenate(inside), np.concatenate(heights)

    def _remember(self, cells: Cells) -> Integers:
        """The numbers of these cells from now on."""
        begin, end = self._size, self._size + len(cells.bound)
        if end > len(self._cells.bound):
            room = Cells(*(np.empty((end, *column.shape[1:]), column.dtype) for column in cells))
            self._cells = Cells.joined((self._cells, room))
        for column, rows in zip(self._cells, cells, strict=True):
            column[begin:end] = rows
        self._size = end
        return np.arange(begin, end)


def _of_each(settled: list[tuple[Integers, Integers]], count: int) -> list[Integers]:
    """The cells of each problem, from pairs of problems and cells."""
    problem, cells = (np.concatenate(column) for column in zip(*settled, strict=True))
    ends = np.bincount(problem, minlength=count).cumsum()[:-1]
    return np.split(cells[problem.argsort(kind="stable")], ends)
