"""What people may set of channels, rules, critics and tasks."""

import math
from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np
import torch

from bra.checks.words import shown

DEFAULT_RUN = 10_000
"""Updates of a run of which nobody has said how long it is."""


def check_real(
    value: Any, name: str, expected: str, fits: Callable[[float], bool] = lambda value: True
) -> float:
    """A number that channels can count in.

    Args:
        value: What was given.
        name: What it is called.
        expected: What it must be, in words.
        fits: Whether it is that.

    Raises:
        ValueError: If it is no number, not finite, does not fit, or is larger than the squares of
            the channels' type allow.
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not (number and abs(value) < float("inf") and fits(value)):
        raise ValueError(f"{name} must be {expected}, got {value if number else shown(value)}")
    if abs(value) > 1:
        check_representable(abs(value), name)
    return float(value)


def check_sizes(sizes: Any, name: str) -> tuple[int, ...]:
    """Whole numbers of at least 1, any number of them.

    Raises:
        ValueError: If it is no list of such.
    """
    if not isinstance(sizes, Iterable) or is_scalar(sizes):
        raise ValueError(f"{name} must be a list of whole numbers, got {shown(sizes)}")
    found = [*sizes]
    if any(isinstance(n, bool) or not isinstance(n, Integral) or n < 1 for n in found):
        raise ValueError(f"{name} must be at least 1, got {shown(found)}")
    return tuple(map(int, found))


def check_flag(value: Any, name: str) -> bool:
    """True or false.

    Raises:
        ValueError: If it is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be true or false, got {shown(value)}")
    return bool(value)


def check_part(value: Any, kind: type, name: str) -> None:
    """A part of its kind, or None.

    Raises:
        TypeError: If it is something else.
    """
    if value is not None:
        check_kind(value, kind, name)


def is_scalar(value: Any) -> bool:
    """Whether it is text, or an array without dimensions, which cannot be iterated over."""
    return isinstance(value, str | bytes) or getattr(value, "ndim", 1) == 0


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
