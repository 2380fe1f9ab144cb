"""What each agent has of its own, with the agents in the last dimension, and what all share."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_unflatten


class Own:
    """What each agent has of its own: `tensor` is (…, R)."""

    def __init__(self, tensor: Tensor) -> None:
        self.tensor = tensor
        self.shape = tensor.shape[:-1]
        self.ndim, self.dtype = len(self.shape), tensor.dtype


Value = Own | Tensor
"""Of one agent: its own, or shared with all others."""


def is_own(value: Any) -> bool:
    """Whether each agent has its own."""
    return isinstance(value, Own)


def is_value(value: Any) -> bool:
    """Whether it is a tensor, in either way."""
    return isinstance(value, Own | Tensor)


def map_values(function: Callable[[Any], Any], values: Any) -> Any:
    """The same tree of arguments, with another value in place of each."""
    leaves, structure = tree_flatten(values, is_leaf=is_own)
    return tree_unflatten(
        [function(leaf) if is_value(leaf) else leaf for leaf in leaves], structure
    )


def places(index: Tensor, length: int) -> Tensor:
    """An index counted from the front, of half the size: vectors hold more of them."""
    short = index.to(torch.int32)
    return torch.where(short < 0, short + length, short)


def outcomes(value: Value, dim: int) -> Tensor:
    """0, 1, … along a dimension, to be broadcast with agents last and compared with `places`."""
    device = value.tensor.device if isinstance(value, Own) else value.device
    count = torch.arange(value.shape[dim], dtype=torch.int32, device=device)
    return count.reshape(-1, *[1] * (value.ndim - dim))


def from_front(dims: Any, ndim: int) -> Any:
    """Dimensions counted from the front; all of them if none are given."""
    if isinstance(dims, int):
        return dims % max(ndim, 1)
    return [dim % max(ndim, 1) for dim in dims or range(ndim)]
