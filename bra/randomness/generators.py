"""Random numbers that are counted, not carried.

What update k draws depends on the run's seed, on k and on the place where it is drawn, and on
nothing else: not on the number of data workers, nor on whether the run was cut and resumed, nor
on who else drew random numbers meanwhile.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from bra.randomness.draws import split, stream_key, to_unit

AHEAD = 64
"""Updates that are drawn at once,"""
KEPT = 2**16
"""as long as there are no more numbers than this."""


def counted_seed(seed: int, update: int, place: str) -> int:
    """A seed in [0, 2⁶³) that is a hash (BLAKE2b) of run, update and place.

    Args:
        seed: The run's seed.
        update: Number of the update that draws.
        place: Name of the place where it draws, such as "world".
    """
    digest = hashlib.blake2b(f"{seed}/{update}/{place}".encode(), digest_size=8).digest()
    return int.from_bytes(digest) >> 1


def counted_generator(seed: int, update: int, place: str) -> Generator:
    """A CPU generator for what `update` draws at `place`."""
    return Generator().manual_seed(counted_seed(seed, update, place))


@contextmanager
def counted(seed: int, update: int, place: str, device: torch.device) -> Iterator[None]:
    """Within, torch's default generators draw what belongs to `update` and `place`.

    `torch.distributions` and `nn.init` know no other generator. Their former states come back on
    exit, so that a run neither sees nor disturbs anybody else's random numbers.

    Args:
        seed: The run's seed.
        update: Number of the update that draws.
        place: Name of the place where it draws.
        device: Its generator is seeded too, if it has one.
    """
    generators = [torch.default_generator]
    if device.type == "cuda":
        index = torch.cuda.current_device() if device.index is None else device.index
        generators.append(torch.cuda.default_generators[index])
    states = [generator.get_state() for generator in generators]
    number = counted_seed(seed, update, place)
    for generator in generators:
        generator.manual_seed(number)
    try:
        yield
    finally:
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)


class Streams:
    """What several runs draw at one place.

    Args:
        seeds: Of the R runs.
        place: Where they draw.
    """

    def __init__(self, seeds: Sequence[int], place: str) -> None:
        self.seeds, self.place = tuple(seeds), place
        self._keys = np.array([[stream_key(seed, place)] for seed in seeds])
        self._made: tuple[Any, ...] | None = None
        self._parts: tuple[Tensor, ...] = ()
        self._given = -1

    def generators(self, update: int) -> Iterator[Generator]:
        """A CPU generator for each run; see `counted_generator`."""
        return (counted_generator(seed, update, self.place) for seed in self.seeds)

    def uniform(self, update: int, count: int) -> Tensor:
        """Numbers in [0, 1) of each run, (R, count), float64; see `bra.randomness.draws`."""
        return self.ahead(update, count, _itself)[0]

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
            keys = split(self._keys, np.arange(start, start + block).reshape(-1, 1, 1))
            parts = make(to_unit(split(keys, np.arange(count)), torch.double))
            self._parts = tuple(part.movedim(1, -1).contiguous().movedim(-1, 1) for part in parts)
            self._made = (start, count, make)
        self._given = update  # once, so that whoever gets it may change it
        return tuple(part[update - start] for part in self._parts)


def _itself(numbers: Tensor) -> tuple[Tensor]:
    return (numbers,)
