"""Checks of what people hand over: one clear line each (what, got, expected, way out)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

Array = Sequence[Any] | np.ndarray | Tensor


def check_utilities(utilities: Array, name: str = "utilities") -> Tensor:
    """A table as a finite float64 tensor (W, A) of its own.

    Raises:
        ValueError: If it is ragged, empty, of another number of dimensions, or not finite.
    """
    try:
        table = torch.as_tensor(utilities, dtype=torch.float64).detach().cpu().clone()
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} must be a table of numbers with rows of equal length: {error}"
        ) from error
    if table.ndim != 2 or table.numel() == 0:
        raise ValueError(
            f"{name} must be a table with a row per state, got shape {tuple(table.shape)}"
        )
    bad = (~table.isfinite()).nonzero()
    if len(bad):
        row, column = bad[0].tolist()
        raise ValueError(
            f"{name} must be finite, got {table[row, column].item()} in row {row}, column {column}"
        )
    return table


def check_prior(prior: Array | None, states: int) -> Tensor:
    """p(ω) as a float64 tensor (W,) of its own that sums to one; uniform if None.

    Raises:
        ValueError: If it has another length, is negative or not finite, or sums to something else
            than 1 (to 1e-6; the rest is normalised away).
    """
    if prior is None:
        return torch.full((states,), 1 / states, dtype=torch.float64)
    weights = torch.as_tensor(prior, dtype=torch.float64).detach().cpu()
    if weights.shape != (states,):
        raise ValueError(
            f"prior must have one probability for each of {states} states, "
            f"got shape {tuple(weights.shape)}"
        )
    if not (weights.isfinite() & (weights >= 0)).all():
        raise ValueError(f"prior must be finite and not negative, got {weights.tolist()}")
    total = weights.sum().item()
    if abs(total - 1) > 1e-6:
        raise ValueError(f"prior must sum to 1, got {total:.8g}; divide it by its sum")
    return weights / total


def check_beta(beta: float, name: str) -> float:
    """An inverse price of information, in utility units' inverse per nat.

    Raises:
        ValueError: If it is not positive and finite.
    """
    if not (isinstance(beta, int | float) and math.isfinite(beta) and beta > 0):
        raise ValueError(f"{name} must be positive and finite, got {beta}")
    return float(beta)


def check_count(count: int, name: str) -> int:
    """A whole number of at least 1.

    Raises:
        ValueError: If it is less than 1 or no whole number.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"{name} must be a whole number of at least 1, got {count}")
    return count
