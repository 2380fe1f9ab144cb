"""Uniform random numbers that are a function of their place alone.

No generator carries a state. Number n that update k draws from a stream is a hash of the stream's
key, of k and of n, in whole-number arithmetic on arrays. So the numbers of many streams are made in
one go, under `torch.func.vmap` and in compiled graphs too, and each is the one that its stream
yields alone.

The hash is SplitMix64 (Steele, Lea & Flood, "Fast splittable pseudorandom number generators",
OOPSLA 2014, doi 10.1145/2660193.2660195), whose output n from seed s, counted from 0, is
finalise(s + (n + 1) γ) modulo 2⁶⁴. Output k from the stream's key is the key of update k, output n
from that is number n. The 64 bits are kept in int64, whose sums and products wrap around as they
should.
"""

import hashlib
import math
from functools import lru_cache
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Bits = TypeVar("Bits", Tensor, NDArray[np.int64])

GAMMA = 0x9E3779B97F4A7C15 - 2**64
"""γ, the odd whole number closest to 2⁶⁴ over the golden ratio."""
UPDATES, NUMBERS = 64, 16
"""What a stream alone makes at once."""
INVERSE_GAMMA = pow(GAMMA, -1, 2**64) - 2**64
"""γ⁻¹, with γ γ⁻¹ = 1 modulo 2⁶⁴."""
MULTIPLIERS = (0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64)


def stream_key(seed: int, place: str) -> int:
    """Key of a stream, in [−2⁶³, 2⁶³): a hash (BLAKE2b) of run and place.

    Args:
        seed: The run's seed.
        place: Name of the place where it draws, such as "world".
    """
    digest = hashlib.blake2b(f"{seed}/{place}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, signed=True)


@lru_cache(maxsize=8)
def stream_keys(seeds: tuple[int, ...], place: str, device: torch.device) -> Tensor:
    """Keys of several runs' streams, (R,); not to be changed."""
    return torch.tensor([stream_key(seed, place) for seed in seeds], device=device)


def split(key: Bits, number: Bits) -> Bits:
    """Output `number` of SplitMix64 with seed `key`, broadcast: all 64 bits."""
    # s + (n + 1) γ = (s γ⁻¹ + n + 1) γ, which leaves no product of known numbers for a compiler to
    # work out with more than 64 bits.
    bits = (key * INVERSE_GAMMA + number + 1) * GAMMA
    bits = (bits ^ _shift(bits, 30)) * MULTIPLIERS[0]
    bits = (bits ^ _shift(bits, 27)) * MULTIPLIERS[1]
    return bits ^ _shift(bits, 31)


class Uniform:
    """Draws what belongs to one update of one stream, one block after the other.

    Args:
        key: Key of the update, of shape (), which under `vmap` may be one for each stream.
    """

    def __init__(self, key: Tensor) -> None:
        self._key = key
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
        return to_unit(self._bits(start, self._drawn), dtype).reshape(shape).to(device)

    def _bits(self, start: int, end: int) -> Tensor | NDArray[np.int64]:
        return split(self._key, torch.arange(start, end, device=self._key.device))


class SingleUniform(Uniform):
    """The same for one stream alone, with less ado for few numbers.

    Args:
        key: Key of the stream.
        update: Number of the update.
    """

    def __init__(self, key: int, update: int) -> None:
        keys, first = _made_at_once(key, update // UPDATES)
        index = update % UPDATES
        # Not of shape (), since NumPy warns of scalars that wrap around.
        self._single_key: NDArray[np.int64] = keys[index]
        self._made: NDArray[np.int64] = first[index]
        self._drawn = 0

    def _bits(self, start: int, end: int) -> NDArray[np.int64]:
        if end > len(self._made):
            self._made = split(self._single_key, np.arange(max(end, 2 * len(self._made))))
        numbers: NDArray[np.int64] = self._made[start:end]
        return numbers


@lru_cache(maxsize=8)
def _made_at_once(key: int, block: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Keys of some updates, and the first few numbers of each.

    For so few it is the number of operations that costs.
    """
    updates = np.arange(block * UPDATES, (block + 1) * UPDATES)
    keys = split(np.array([key]), updates).reshape(-1, 1)
    return keys, split(keys, np.arange(NUMBERS))


def to_unit(bits: Tensor | NDArray[np.int64], dtype: torch.dtype | None = None) -> Tensor:
    """The highest bits as numbers in [0, 1): 53 of them in float64, 24 in float32.

    Args:
        bits: 64 of them, int64.
        dtype: Of the numbers; None for torch's default.
    """
    dtype = dtype or torch.get_default_dtype()
    kept = _precision(dtype)
    if isinstance(bits, Tensor):
        high = _shift(bits, 64 - kept)
    else:
        high = torch.from_numpy(_shift(bits, 64 - kept))
    return high.to(dtype) * 2.0**-kept


@lru_cache
def _precision(dtype: torch.dtype) -> int:
    """Bits of a number just below 1."""
    return 1 - round(math.log2(torch.finfo(dtype).eps))


def _shift(bits: Bits, places: int) -> Bits:
    """To the right, with zeros coming in from the left."""
    return (bits >> places) & ((1 << (64 - places)) - 1)
