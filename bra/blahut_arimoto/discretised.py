"""The optimum of continuous states or actions, on grids that become finer."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bra.blahut_arimoto.results import Serial
from bra.blahut_arimoto.two_channels import serial

POINTS = (9, 16, 30, 60)
"""Points of the grids along each dimension.

None divides the next, so that two grids do not agree only because they share their points.
"""
MOST_ENTRIES = 2**20
"""Utilities in the largest table."""
MOST_PERCEPTS = 32
TOLERANCE = 1e-3

Problem = Callable[[int], tuple[Tensor, Tensor]]
"""U(ω,a), (W, A), and p(ω), (W,), on a grid of so many points along each dimension."""


@dataclass(frozen=True)
class Discretised:
    """The optimum on the finest grid: no certificate, but the best known, see `serial`.

    Attributes:
        optimum: The best serial solution on that grid.
        error: By how much its J differs from that on the grid before, about half as fine.
        points: Of the grid, along each dimension.
        converged: Whether `error` is as small as was asked for.
    """

    optimum: Serial
    error: float
    points: int
    converged: bool


def discretised(
    problem: Problem,
    percepts: int | None,
    beta_perception: float,
    beta_action: float,
    restarts: int = 32,
    seed: int = 0,
    tolerance: float = TOLERANCE,
) -> Discretised:
    """Refines the grid until J changes by less than `tolerance` times what information is worth.

    That is E[max_a U] − max_a E[U], if it cost nothing. Grids have up to 60 points along each
    dimension, and tables up to 2²⁰ utilities.

    Args:
        problem: Makes the table of a grid.
        percepts: |X|; None for percepts that are no finite set. Of these as many as states or
            actions suffice (Carathéodory), and 32 are taken at most.
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        restarts: As for `serial`.
        seed: As for `serial`.
        tolerance: Share of that worth.
    """
    best: Discretised | None = None
    for points in POINTS:
        utilities, prior = problem(points)
        if best and utilities.numel() > MOST_ENTRIES:
            break
        count = percepts or min(*utilities.shape, MOST_PERCEPTS)
        prices = (beta_perception, beta_action)
        found = serial(utilities, prior, count, *prices, restarts, seed, budget=2 * restarts)
        worth = (prior @ utilities.amax(1) - (prior @ utilities).amax()).item()
        error = abs(float(found.objective) - float(best.optimum.objective)) if best else torch.inf
        best = Discretised(found, error, points, error <= tolerance * worth)
        if best.converged:
            break
    assert best is not None  # there are grids
    return best
