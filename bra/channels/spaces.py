"""Between gymnasium spaces, the numbers of a network, and distributions."""

import math
from typing import Any

import torch
from gymnasium.spaces import Discrete, Space, Tuple
from torch import Tensor
from torch.distributions import Distribution, Independent, Normal

from bra.channels.distributions import Categorical

MINIMUM_SCALE = 1e-3

Condition = Tensor | tuple[Tensor, ...]
"""What a channel is given: a tensor, or one for each part of a `Tuple` space."""


def parts_of(condition: Condition) -> tuple[Tensor, ...]:
    """The parts of a condition, the signal last."""
    return condition if isinstance(condition, tuple) else (condition,)


def signal_space(space: Space[Any]) -> Space[Any]:
    """Of a `Tuple` the last part, else the space itself."""
    return space[-1] if isinstance(space, Tuple) else space


def feature_count(space: Space[Any]) -> int:
    """Length of a condition's feature vector: n for `Discrete(n)`, the volume of a `Box`."""
    return int(space.n) if isinstance(space, Discrete) else math.prod(space.shape or ())


def features(space: Space[Any], condition: Tensor, dtype: torch.dtype) -> Tensor:
    """A condition as a vector: one-hot for `Discrete`, flattened for `Box`.

    Args:
        space: Where `condition` lives.
        condition: (*batch,) indices, or (*batch, *space.shape); 8-bit images are scaled to [0, 1].
        dtype: Type of the features.

    Returns:
        (*batch, feature_count(space)).

    Raises:
        ValueError: If the trailing shape of `condition` is not that of the space.
    """
    if isinstance(space, Discrete):
        return (condition.unsqueeze(-1) == torch.arange(space.n, device=condition.device)).to(dtype)
    values = box_values(space, condition, dtype)
    batch = values.shape[: values.ndim - len(space.shape or ())]
    return values.reshape((*batch, feature_count(space)))


def row_counts(space: Space[Any], name: str) -> list[int]:
    """How many conditions a `Discrete` space has, or each part of a `Tuple` of such.

    Raises:
        ValueError: If a part is not `Discrete`; the message says whose condition space that is.
    """
    parts = list(space) if isinstance(space, Tuple) else [space]
    for part in parts:
        if not isinstance(part, Discrete):
            raise ValueError(
                f"{name} keeps a row for each condition and cannot have {part} among its "
                "conditions; take an MLP, or a task whose observations are indices"
            )
    return [int(part.n) for part in parts if isinstance(part, Discrete)]


def row_number(counts: list[int], condition: Condition) -> Tensor:
    """The row of a condition, in a table over `row_counts`."""
    parts = parts_of(condition)
    number = torch.zeros((), dtype=torch.long, device=parts[0].device)
    for count, part in zip(counts, parts, strict=True):
        number = number * count + part
    return number


def box_values(space: Space[Any], condition: Tensor, dtype: torch.dtype) -> Tensor:
    """A condition from a `Box` as floats, 8-bit images scaled to [0, 1].

    Raises:
        ValueError: If the trailing shape of `condition` is not that of the space.
    """
    shape = space.shape or ()
    if condition.shape[condition.ndim - len(shape) :] != shape:
        raise ValueError(
            f"condition of shape {tuple(condition.shape)} does not end in {shape}, "
            f"the shape of its space {space}"
        )
    values = condition.to(dtype)
    return values / 255 if condition.dtype == torch.uint8 else values


def parameter_count(space: Space[Any]) -> int:
    """Numbers per condition that fix a distribution over `space`: logits, or means and scales."""
    return int(space.n) if isinstance(space, Discrete) else 2 * math.prod(space.shape or ())


def distribution(space: Space[Any], parameters: Tensor) -> Distribution:
    """The distribution over `space` that a network's outputs stand for.

    Args:
        space: `Discrete(n)` gives `Categorical(logits=parameters)`; a `Box` gives independent
            normals, first half of the parameters the means, second half the log-scales.
        parameters: (*batch, parameter_count(space)).

    Returns:
        Batch shape *batch; event shape () for `Discrete`, space.shape for `Box`.
    """
    if isinstance(space, Discrete):
        return Categorical(logits=parameters)
    shape = space.shape or ()
    batch = parameters.shape[:-1]
    mean, log_scale = (half.reshape((*batch, *shape)) for half in parameters.chunk(2, dim=-1))
    return gaussian(mean, log_scale, event_dims=len(shape))


def gaussian(mean: Tensor, log_scale: Tensor, event_dims: int) -> Distribution:
    """Independent normals N(mean, s²) with s = MINIMUM_SCALE + exp(log_scale).

    The lower bound keeps densities, and with them sampled information, finite.
    """
    normal = Normal(mean, MINIMUM_SCALE + log_scale.exp(), validate_args=False)
    return Independent(normal, event_dims, validate_args=False)
