"""Ways in which a sensor shows a finite number of world-states."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any, Literal

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, Space
from torch import Tensor

from bra.checks.arrays import Array, as_numbers

Code = Literal["onehot", "index", "binary", "bipolar"]


def observation_table(
    observations: Code | Array | Space[Any], count: int, numbers: Sequence[int] | None = None
) -> tuple[Space[Any], Tensor | None]:
    """The sensor signal of every world-state.

    Args:
        observations: "onehot" (W,), "index" (a `Discrete` space), "binary" (the 0/1 code of the
            state's number, most significant bit first), "bipolar" (the same as ±1), the signals
            themselves, (W, *shape), or the space of signals that are drawn with noise. Images of
            8 bits keep their type, and channels scale them to [0, 1].
        count: W, the number of states.
        numbers: A number ≥ 0 per state, for the binary codes; 0 … W − 1 if None.

    Returns:
        The space of the signals, and the signals of all states, (W,) or (W, *shape); None for a
        noisy sensor.

    Raises:
        ValueError: If the code is unknown, or there is not one finite signal, or one number ≥ 0,
            per state.
    """
    numbers = range(count) if numbers is None else numbers
    listed = isinstance(numbers, Sequence | np.ndarray) and np.ndim(numbers) == 1
    whole = listed and all(isinstance(number, Integral) and number >= 0 for number in numbers)
    if not whole or len(numbers) != count:
        raise ValueError(f"expected {count} whole state numbers of at least 0, got {numbers}")
    numbers = [*map(int, numbers)]
    if isinstance(observations, Space):
        return observations, None
    if not isinstance(observations, str):
        table = as_numbers(observations, "observations must be an array of numbers")
        table = table.to(torch.get_default_dtype())
        if table.ndim < 2 or len(table) != count or not table.isfinite().all():
            raise ValueError(
                f"observations must be finite and of shape ({count}, …), one signal per state, "
                f"got shape {tuple(table.shape)}"
            )
        if table.ndim > 2 and getattr(observations, "dtype", None) in (np.uint8, torch.uint8):
            return Box(0, 255, tuple(table.shape[1:]), np.uint8), table.to(torch.uint8)
        return _box(-np.inf, np.inf, table), table
    match observations:
        case "index":
            return Discrete(count), torch.arange(count)
        case "onehot":
            table = torch.eye(count)
            return _box(0, 1, table), table
        case "binary" | "bipolar":
            width = max(1, max(numbers).bit_length())
            places = range(width - 1, -1, -1)
            bits = torch.tensor([[number >> place & 1 for place in places] for number in numbers])
            table = bits.float() if observations == "binary" else 2.0 * bits - 1.0
            return _box(table.min().item(), 1, table), table
    raise ValueError(
        f"observations must be onehot, index, binary, bipolar or an array, got {observations!r}"
    )


def _box(low: float, high: float, table: Tensor) -> Box:
    return Box(low, high, shape=tuple(table.shape[1:]), dtype=np.float32)


def as_signals(space: Space[Any], observation: Array) -> Tensor:
    """Signals of a space from tensors, arrays or lists, as channels take them.

    Args:
        space: Where they live, `Discrete` or `Box`.
        observation: (*batch,) whole numbers, or (*batch, *space.shape); images of 8 bits stay so.

    Returns:
        Of the same shape, on the CPU.

    Raises:
        ValueError: If these are no numbers, or none of the space: of another shape, not finite, or
            beyond a `Discrete` space's.
    """
    expected = f"observation must be of {space}"
    values = as_numbers(observation, expected)
    if isinstance(space, Discrete):
        bad = values[(values != values.round()) | (values < 0) | (values >= int(space.n))]
        if len(bad):
            raise ValueError(f"{expected}, got {bad[0].item():g}")
        return values.long()
    shape = space.shape or ()
    if values.shape[max(0, values.ndim - len(shape)) :] != shape:
        raise ValueError(f"{expected}, got shape {tuple(values.shape)}, which does not end in it")
    if not values.isfinite().all():
        raise ValueError(f"{expected} and finite, got {values[~values.isfinite()][0].item()}")
    bytes_ = getattr(observation, "dtype", None) in (torch.uint8, np.uint8)
    return values.to(torch.uint8 if bytes_ else torch.get_default_dtype())


def has_grey_levels(space: Box) -> bool:
    """Whether all numbers of a space have the same bounds, from black to white."""
    low, high = space.low, space.high
    same = (low == low.flat[0]).all() and (high == high.flat[0]).all()
    return bool(same and space.is_bounded() and high.flat[0] > low.flat[0])


def grey_levels(space: Space[Any], signals: Tensor) -> Tensor:
    """Signals of a space that `has_grey_levels`, for people to look at: from 0 to 1."""
    assert isinstance(space, Box)
    low, high = float(space.low.flat[0]), float(space.high.flat[0])
    return (signals - low) / (high - low)
