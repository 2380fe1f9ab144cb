"""Keys of random numbers: one for each seed and stream, split by update and number."""

from itertools import product

import numpy as np
import pytest
import torch

from bra.randomness.keys import split, stream_key, stream_keys, update_key

# Seed 1234567 from Rosetta Code, seed 0 from the tests of Vigna's splitmix64.c in other libraries.
PUBLISHED = {
    1234567: [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ],
    0: [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F, 0xF88BB8A8724C81EC],
}
CPU = torch.device("cpu")


@pytest.mark.parametrize("seed", PUBLISHED)
def test_it_is_splitmix64(seed):
    outputs = PUBLISHED[seed]
    by_torch = split(torch.tensor(seed), torch.arange(len(outputs)))
    by_numpy = split(np.array([seed]), np.arange(len(outputs)))
    by_python = [split(seed, number) for number in range(len(outputs))]
    for bits in (by_torch, by_numpy, by_python):
        assert [int(number) % 2**64 for number in bits] == outputs


def test_keys_are_the_same_on_every_machine():
    # Runs of old checkpoints depend on it: BLAKE2b of "seed/stream", 8 bytes big-endian, signed.
    assert stream_key(0, "world") == -5362532551688859600
    assert stream_key(42, "update") == 2918533642918793850
    assert stream_keys((0, 42), "world", CPU).tolist() == [
        stream_key(seed, "world") for seed in (0, 42)
    ]


def test_the_key_of_an_update_is_an_output_of_its_streams_generator():
    keys = [update_key(42, "update", update) for update in (0, 1, 10**9)]
    numbers = torch.tensor([0, 1, 10**9])
    assert split(torch.tensor(stream_key(42, "update")), numbers).tolist() == keys


def test_every_seed_stream_and_update_has_its_own():
    # Keys have 64 bits: two of some thousand are equal with probability 1e-12.
    seeds = (-1, *range(100), 2**31)
    streams = ("world", "update", "update 1", "predict", "1/world")
    cells = list(product(seeds, streams, (*range(12), 10**9)))
    assert len({update_key(*cell) for cell in cells}) == len(cells)
