"""Uniform random numbers from keys, which are a function of seed, stream, update and position."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from bra.randomness.generators import counted_generator
from bra.randomness.keys import shift, split, stream_key

UniformNumbers = Callable[..., Tensor]
"""Makes random numbers in [0, 1), called like `torch.rand`."""

AHEAD = 64
"""Updates that are drawn at once,"""
KEPT = 2**16
"""as long as there are no more numbers than this."""


class Uniform:
    """Draws what belongs to one update of one stream, one block after the other.

    Args:
        key: Key of the update; of shape () if it is a tensor, which under `vmap` may be one for
            each stream.
    """

    def __init__(self, key: int | Tensor) -> None:
        # By NumPy, which is faster for few numbers; not of shape (), since it warns of scalars
        # that wrap around.
        self._key = key if isinstance(key, Tensor) else np.array([key])
        self._drawn = 0

    def __call__(
        self,
        shape: tuple[int, ...],
        dtype: torch.dtype | None = None,
        device: torch.device | None = None,
    ) -> Tensor:
        """Numbers in [0, 1), called like `torch.rand`.

        Args:
            shape: Of the block.
            dtype: Of the numbers; None for torch's default.
            device: Of the numbers.
        """
        start, self._drawn = self._drawn, self._drawn + math.prod(shape)
        bits: Tensor | NDArray[np.int64]
        if isinstance(self._key, Tensor):
            positions = torch.arange(start, self._drawn, device=self._key.device)
            bits = split(self._key, positions)
        else:
            bits = split(self._key, np.arange(start, self._drawn))
        return to_unit(bits, dtype).reshape(shape).to(device)


class Streams:
    """What several runs draw from streams of the same name.

    Args:
        seeds: Of the R runs.
        stream: Name of the streams.
    """

    def __init__(self, seeds: Sequence[int], stream: str) -> None:
        self.seeds, self.stream = tuple(seeds), stream
        self._keys = np.array([[stream_key(seed, stream)] for seed in seeds])
        self._made: tuple[Any, ...] | None = None
        self._parts: tuple[Tensor, ...] = ()
        self._given = -1

    def generators(self, update: int) -> Iterator[Generator]:
        """A CPU generator for each run; see `counted_generator`."""
        return (counted_generator(seed, update, self.stream) for seed in self.seeds)

    def uniform(self, update: int, count: int) -> Tensor:
        """Numbers in [0, 1) of each run, (R, count), float64."""
        return self.ahead(update, count, _itself)[0]

    def along(self, updates: range, count: int) -> Tensor:
        """Numbers in [0, 1) of each update and run, (n, R, count), float64."""
        keys = split(self._keys, np.arange(updates.start, updates.stop).reshape(-1, 1, 1))
        return to_unit(split(keys, np.arange(count)), torch.double)

    def ahead(
        self,
        update: int,
        count: int,
        make: Callable[[Tensor], tuple[Tensor, ...]],
        size: int = 1,
    ) -> tuple[Tensor, ...]:
        """What is made of the numbers of one update, (R, …), with memory contiguous along the runs.

        That of a few updates to come is made at once and kept, since for few runs it is the number
        of operations that costs.

        Args:
            update: Number of the update.
            count: Numbers of each run.
            make: From numbers (…, R, count), float64, to parts (…, R, …) that depend on nothing
                else.
            size: Numbers that it makes of one.
        """
        block = max(1, min(AHEAD, KEPT // (len(self.seeds) * count * size)))
        start = update - update % block
        if self._made != (start, count, make) or update <= self._given:
            parts = make(self.along(range(start, start + block), count))
            self._parts = tuple(part.movedim(1, -1).contiguous().movedim(-1, 1) for part in parts)
            self._made = (start, count, make)
        self._given = update  # once, so that whoever gets it may change it
        return tuple(part[update - start] for part in self._parts)


def to_unit(bits: Tensor | NDArray[np.int64], dtype: torch.dtype | None = None) -> Tensor:
    """The highest bits as numbers in [0, 1): 53 of them in float64, 24 in float32.

    Args:
        bits: 64 of them, int64.
        dtype: Of the numbers; None for torch's default.
    """
    dtype = dtype or torch.get_default_dtype()
    kept = _precision(dtype)
    if isinstance(bits, Tensor):
        high = shift(bits, 64 - kept)
    else:
        high = torch.from_numpy(shift(bits, 64 - kept))
    return high.to(dtype) * 2.0**-kept


@lru_cache
def _precision(dtype: torch.dtype) -> int:
    """Bits of a number just below 1."""
    return 1 - round(math.log2(torch.finfo(dtype).eps))


def _itself(numbers: Tensor) -> tuple[Tensor]:
    return (numbers,)
