"""What people may set of channels, rules, critics and tasks."""

from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np

from bra.checks import check_kind, check_representable
from bra.words import shown


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
