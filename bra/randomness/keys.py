"""Keys of random numbers: one for each seed and stream, split by update, split by number.

The key of a stream is a hash of the run's seed and the stream's name. Output k of a generator with
this key is the key of update k, and output n of a generator with that is its number n, all in
whole-number arithmetic without a state. So the numbers of many streams are made in one go, under
`torch.func.vmap` and in compiled graphs too, and each is the one that its stream yields alone.

The generator is SplitMix64 (Steele, Lea & Flood, "Fast splittable pseudorandom number generators",
OOPSLA 2014, doi 10.1145/2660193.2660195), whose output n from seed s, counted from 0, is
finalise(s + (n + 1) γ) modulo 2⁶⁴. The 64 bits are kept in int64, whose sums and products wrap
around as they should.
"""

import hashlib
from functools import lru_cache
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Bits = TypeVar("Bits", int, Tensor, NDArray[np.int64])

GAMMA = 0x9E3779B97F4A7C15 - 2**64
"""γ, the odd whole number closest to 2⁶⁴ over the golden ratio."""
INVERSE_GAMMA = pow(GAMMA, -1, 2**64) - 2**64
"""γ⁻¹, with γ γ⁻¹ = 1 modulo 2⁶⁴."""
MULTIPLIERS = (0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64)


def stream_key(seed: int, stream: str) -> int:
    """Key of a stream, in [−2⁶³, 2⁶³): a hash (BLAKE2b) of the run's seed and the stream's name.

    Args:
        seed: The run's seed.
        stream: What is drawn, such as "world".
    """
    digest = hashlib.blake2b(f"{seed}/{stream}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, signed=True)


def update_key(seed: int, stream: str, update: int) -> int:
    """Key of one update of a stream, in [−2⁶³, 2⁶³)."""
    return (split(stream_key(seed, stream), update) + 2**63) % 2**64 - 2**63


@lru_cache(maxsize=8)
def stream_keys(seeds: tuple[int, ...], stream: str, device: torch.device) -> Tensor:
    """Keys of several runs' streams, (R,); not to be changed."""
    return torch.tensor([stream_key(seed, stream) for seed in seeds], device=device)


def split(key: Bits, number: Bits) -> Bits:
    """Output `number` of SplitMix64 with seed `key`, broadcast: all 64 bits.

    Of Python's whole numbers, which do not wrap around, it is one that is equal modulo 2⁶⁴.
    """
    # s + (n + 1) γ = (s γ⁻¹ + n + 1) γ, which leaves no product of known numbers for a compiler to
    # work out with more than 64 bits.
    bits = (key * INVERSE_GAMMA + number + 1) * GAMMA
    bits = (bits ^ shift(bits, 30)) * MULTIPLIERS[0]
    bits = (bits ^ shift(bits, 27)) * MULTIPLIERS[1]
    return bits ^ shift(bits, 31)


def shift(bits: Bits, places: int) -> Bits:
    """The 64 bits shifted to the right, with zeros coming in from the left."""
    return (bits >> places) & ((1 << (64 - places)) - 1)
