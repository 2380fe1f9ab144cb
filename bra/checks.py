"""Checks of what people hand over: one clear line each (what, expected, got, way out)."""

import math
from numbers import Integral, Real
from typing import Any

import torch
from torch import Tensor

from bra.arrays import Array as Array
from bra.arrays import as_numbers
from bra.words import amount, shown

DEFAULT_RUN = 10_000
"""Updates of a run of which nobody has said how long it is."""


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


def check_beta(beta: float, name: str, infinite: bool = False) -> float:
    """An inverse price of information, in utility units' inverse per nat.

    Raises:
        ValueError: If it is no number, or not positive and finite, if it may not be `infinite`.
    """
    if isinstance(beta, bool) or not isinstance(beta, Real):
        raise ValueError(f"{name} must be positive and finite, got {shown(beta)}; give one number")
    check_betas(float(beta), name, infinite)
    return float(beta)


def refuse_free(beta_1: float | Tensor, beta_2: float | Tensor, beta_3: float | Tensor) -> None:
    """Raises ValueError if in some set of prices information is free altogether."""
    free_1, free_2, free_3 = (torch.as_tensor(beta).isinf() for beta in (beta_1, beta_2, beta_3))
    if (free_1 & free_2 & free_3).any():
        raise ValueError(
            "beta_perception, beta_action and beta_direct are all inf: information is free, and "
            "the solution is the best action in every state (argmax)"
        )


def check_rate(bits: float, name: str) -> float:
    """A rate of information in bits, or a budget for one.

    Raises:
        ValueError: If it is no number, negative or not finite.
    """
    number = isinstance(bits, Real) and not isinstance(bits, bool)
    if not (number and 0 <= bits < math.inf):
        raise ValueError(f"{name} must be a finite number of at least 0, got {shown(bits)}")
    return float(bits)


def check_price_or_budget(beta: Any, bits: float | None, channel: str) -> None:
    """Refuses a price and a budget of the same channel's information.

    Raises:
        ValueError: If both are given.
    """
    if beta is not None and bits is not None:
        raise ValueError(
            f"the {channel} channel has a price and a budget: beta_{channel} {beta} and "
            f"{channel}_bits {bits}; leave one of them out"
        )


def check_representable(quantity: float, name: str) -> None:
    """Asks for numbers whose squares the channels' type can hold, since optimizers square them.

    Raises:
        ValueError: If it is too large, or too small.
    """
    dtype = torch.get_default_dtype()
    largest = math.sqrt(torch.finfo(dtype).max)
    if not 1 / largest < quantity < largest:
        raise ValueError(
            f"{name} must be between {1 / largest:.2g} and {largest:.2g} for channels of {dtype}, "
            f"got {quantity:g}; U/c at prices cβ has the same optimum"
        )


def check_betas(betas: float | Array, name: str, infinite: bool = False) -> Tensor:
    """Inverse prices of information, as a float64 tensor of its own and of their shape.

    Args:
        betas: Number or numbers.
        name: What they are called.
        infinite: Whether information may be free.

    Raises:
        ValueError: If there are none, or they are no numbers, or not all positive and finite.
    """
    prices = check_numbers(betas, name)
    bad = prices[~((prices > 0) & (prices.isfinite() | infinite))]
    if len(bad):
        expected, way_out = ("", "inf") if infinite else (" and finite", "a large number")
        raise ValueError(
            f"{name} must be positive{expected}, got {bad[0].item():g}; "
            f"where information is free give {way_out}"
        )
    if (1 / prices).isinf().any():
        raise ValueError(
            f"{name} is the inverse of a price that numbers cannot hold, got "
            f"{prices.min().item():g}; give a larger one"
        )
    return prices


def check_numbers(numbers: float | Array, name: str) -> Tensor:
    """Numbers as a float64 tensor of its own and of their shape.

    Raises:
        ValueError: If there are none, or they are no numbers.
    """
    values = as_numbers(numbers, f"{name} must be a number or an array of numbers")
    if values.numel() == 0:
        raise ValueError(f"{name} must hold at least one number, got shape {tuple(values.shape)}")
    return values


def broadcast_betas(**betas: Tensor) -> tuple[Tensor, ...]:
    """Prices, by name, in their common shape.

    Raises:
        ValueError: If they have none.
    """
    try:
        shape = sum(betas.values(), torch.zeros(())).shape
    except RuntimeError as error:
        shapes = " and ".join(str(tuple(beta.shape)) for beta in betas.values())
        raise ValueError(
            f"{' and '.join(betas)} must broadcast against each other, got shapes {shapes}"
        ) from error
    return tuple(beta.expand(shape) for beta in betas.values())


def check_count(count: int, name: str) -> int:
    """A whole number of at least 1.

    Raises:
        ValueError: If it is less than 1 or no whole number.
    """
    if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
        raise ValueError(f"{name} must be a whole number of at least 1, got {shown(count)}")
    return int(count)


def check_seed(seed: int, name: str = "seed") -> int:
    """The number of a family of random numbers.

    Raises:
        ValueError: If it is negative or no whole number.
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise ValueError(f"{name} must be a whole number of at least 0, got {shown(seed)}")
    return int(seed)


def check_kind(value: Any, kind: type, name: str) -> None:
    """Makes sure that a part is an object of its kind.

    Raises:
        TypeError: If it is something else, its class for example.
    """
    if isinstance(value, kind):
        return
    if isinstance(value, type) and issubclass(value, kind):
        raise TypeError(f"{name} must be made, got the class; pass {value.__name__}(…)")
    raise TypeError(f"{name} must be of class {kind.__name__}, got {shown(value)}")


def check_seconds(seconds: float, name: str) -> float:
    """A time in seconds.

    Raises:
        ValueError: If it is no number, or not positive and finite.
    """
    number = isinstance(seconds, Real) and not isinstance(seconds, bool)
    if not (number and 0 < seconds < float("inf")):
        raise ValueError(f"{name} must be a positive number of seconds, got {shown(seconds)}")
    return float(seconds)


def check_length(length: int | float, name: str) -> int | float:
    """A number of updates, or a share of a run, see `in_updates`.

    Raises:
        ValueError: If it is neither a whole number of at least 1 nor between 0 and 1.
    """
    if isinstance(length, float) and 0 < length < 1:
        return length
    try:
        return check_count(length, name)  # type: ignore[arg-type]  # which it looks at
    except ValueError as error:
        raise ValueError(f"{error}; less than 1 is a share of the run") from error


def in_updates(length: int | float, run: int = DEFAULT_RUN) -> int:
    """A length in updates; between 0 and 1 it is a share of a run of so many updates."""
    return max(1, round(length * run)) if isinstance(length, float) else length


def _as_table(values: Array, name: str) -> Tensor:
    table = as_numbers(values, f"{name} must be a table of numbers with rows of equal length")
    if table.ndim != 2 or table.numel() == 0:
        raise ValueError(
            f"{name} must be a table with a row per state, got shape {tuple(table.shape)}"
        )
    return table
