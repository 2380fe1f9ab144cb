"""Prices of information, and rates of it."""

import math
from numbers import Real
from typing import Any

import torch
from torch import Tensor

from bra.checks.arrays import Array, check_numbers
from bra.checks.words import shown


def check_beta(beta: float, name: str, infinite: bool = False) -> float:
    """An inverse price of information, in utility units' inverse per nat.

    Raises:
        ValueError: If it is no number, or not positive and finite, if it may not be `infinite`.
    """
    if isinstance(beta, bool) or not isinstance(beta, Real):
        raise ValueError(f"{name} must be positive and finite, got {shown(beta)}; give one number")
    check_betas(float(beta), name, infinite)
    return float(beta)


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
