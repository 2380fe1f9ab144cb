"""Tables of utilities, priors and signals."""

import torch
from torch import Tensor

from bra.checks.arrays import Array, as_numbers
from bra.checks.words import amount


def check_utilities(utilities: Array) -> Tensor:
    """A table of utilities as a float64 tensor (W, A) of its own.

    An action that is forbidden in a state has −inf there: no optimum and no agent takes it.

    Raises:
        ValueError: If it is ragged, empty, of another number of dimensions, holds NaN or +inf, or
            forbids every action in some state.
    """
    table = _as_table(utilities, "utilities")
    bad = (table.isnan() | table.isposinf()).nonzero()
    if len(bad):
        row, column = bad[0].tolist()
        raise ValueError(
            f"utilities must be finite, or -inf for a forbidden action, got "
            f"{table[row, column].item()} in row {row}, column {column}"
        )
    barred = table.isneginf().all(1).nonzero()
    if len(barred):
        raise ValueError(
            f"utilities must leave an action in every state, got -inf for all of row "
            f"{barred[0].item()}; give one of them a finite utility"
        )
    return table


def check_table(values: Array, name: str) -> Tensor:
    """A finite table of numbers as a float64 tensor (W, d) of its own.

    Raises:
        ValueError: If it is ragged, empty, of another number of dimensions, or not finite.
    """
    table = _as_table(values, name)
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
    expected = f"prior must have one probability for each of {amount(states, 'state')}"
    weights = as_numbers(prior, expected)
    if weights.shape != (states,):
        raise ValueError(f"{expected}, got shape {tuple(weights.shape)}; None stands for uniform")
    if not (weights.isfinite() & (weights >= 0)).all():
        raise ValueError(f"prior must be finite and not negative, got {weights.tolist()}")
    total = weights.sum().item()
    if abs(total - 1) > 1e-6:
        raise ValueError(f"prior must sum to 1, got {total:.8g}; divide it by its sum")
    return weights / total


def check_conditional(table: Array, states: int) -> Tensor:
    """p(s|ω) as a float64 tensor (W, S) of its own whose rows sum to one.

    Raises:
        ValueError: If there is not one row per state, or one is no distribution (to 1e-6; the rest
            is normalised away).
    """
    rows = check_table(table, "signal_given_state")
    expected = f"signal_given_state must have one row for each of {amount(states, 'state')}"
    if len(rows) != states:
        raise ValueError(f"{expected}, got {len(rows)}")
    bad = ((rows < 0).any(1) | ((rows.sum(1) - 1).abs() > 1e-6)).nonzero()
    if len(bad):
        row = int(bad[0])
        raise ValueError(
            f"signal_given_state must have rows of probabilities that sum to 1, got "
            f"{rows[row].tolist()} in row {row}; divide it by its sum"
        )
    return rows / rows.sum(1, keepdim=True)


def _as_table(values: Array, name: str) -> Tensor:
    table = as_numbers(values, f"{name} must be a table of numbers with rows of equal length")
    if table.ndim != 2 or table.numel() == 0:
        raise ValueError(
            f"{name} must be a table with a row per state, got shape {tuple(table.shape)}"
        )
    return table
