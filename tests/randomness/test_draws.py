"""Uniform random numbers that are a function of their place alone."""

import numpy as np
import pytest
import torch

from bra.randomness.draws import SingleUniform, Uniform, split, stream_key, stream_keys, to_unit
from bra.randomness.generators import AHEAD, Streams

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
    for bits in (by_torch, by_numpy):
        assert [int(number) % 2**64 for number in bits] == outputs


def test_keys_are_the_same_on_every_machine():
    # Runs of old checkpoints depend on it: BLAKE2b of "seed/place", 8 bytes big-endian, signed.
    assert stream_key(0, "world") == -5362532551688859600
    assert stream_key(42, "update") == 2918533642918793850
    keys = {stream_key(seed, place) for seed in range(1000) for place in ("world", "update")}
    assert len(keys) == 2000  # equal ones with probability 1e-13
    assert stream_keys((0, 42), "world", CPU).tolist() == [
        stream_key(seed, "world") for seed in (0, 42)
    ]


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [(torch.float64, 53), (torch.float32, 24), (torch.float16, 11), (torch.bfloat16, 8)],
)
def test_numbers_are_at_least_0_and_less_than_1(dtype, kept):
    lowest, highest = to_unit(torch.tensor([0, -1]), dtype)
    assert lowest == 0
    assert highest.dtype == dtype
    assert highest.double() == 1 - 2.0**-kept


def draw_together(seeds, update, *shapes):
    def of_one(key):
        uniform = Uniform(split(key, torch.tensor(update)))
        return tuple(uniform(shape) for shape in shapes)

    return torch.vmap(of_one)(stream_keys(seeds, "update", CPU))


def test_many_streams_draw_what_each_draws_alone():
    shapes = ((2, 3), (), (4,))
    together = draw_together((5, 6, 7), 11, *shapes)
    for index, seed in enumerate((5, 6, 7)):
        alone = SingleUniform(stream_key(seed, "update"), 11)
        assert all(torch.equal(block[index], alone(block.shape[1:])) for block in together)


def test_blocks_follow_each_other():
    parts, whole = (SingleUniform(stream_key(0, "update"), 3) for _ in range(2))
    assert torch.equal(torch.cat([parts((3,)), parts((2,))]), whole((5,)))


def test_default_generators_are_left_alone():
    before = torch.get_rng_state()
    draw_together((0, 1), 0, (5,))
    SingleUniform(0, 0)((5,))
    Streams([0, 1], "world").uniform(0, 5)
    assert torch.equal(before, torch.get_rng_state())


def test_numbers_of_a_stream_do_not_depend_on_what_was_asked_before():
    streams = Streams([3, 4], "world")
    updates = (0, AHEAD - 1, AHEAD, 10**9, 1)
    found = [streams.uniform(update, 2) for update in updates]
    for update, numbers in zip(updates, found, strict=True):
        assert torch.equal(numbers, Streams([3, 4], "world").uniform(update, 2))
        assert torch.equal(numbers[1:], Streams([4], "world").uniform(update, 2))
        alone = SingleUniform(stream_key(4, "world"), update)
        assert torch.equal(numbers[1], alone((2,), torch.double))


SIDE = 256
AXES = {
    "positions": lambda: SingleUniform(stream_key(0, "update"), 0)((SIDE, SIDE), torch.double),
    "updates": lambda: torch.stack(
        [SingleUniform(stream_key(0, "update"), k)((SIDE,), torch.double) for k in range(SIDE)]
    ),
    "seeds": lambda: Streams(range(SIDE), "update").uniform(0, SIDE),
}


@pytest.mark.parametrize("axis", AXES)
def test_numbers_are_uniform(axis):
    # χ² over 64 cells, 63 degrees of freedom: beyond 132 with probability 1e-6. Seeds are fixed.
    counts = torch.histc(AXES[axis](), 64, 0, 1)
    expected = SIDE**2 / 64
    assert ((counts - expected).square() / expected).sum() < 132


@pytest.mark.parametrize("axis", AXES)
def test_neighbours_are_independent(axis):
    # A correlation of n pairs is normal with deviation n^(−1/2): beyond 5 of them with
    # probability 6e-7, four times. Seeds are fixed.
    numbers = AXES[axis]() - 0.5
    for step in (1, 2):
        for first, second in (
            (numbers[step:], numbers[:-step]),
            (numbers[:, step:], numbers[:, :-step]),
        ):
            correlation = 12 * (first * second).mean()
            assert correlation.abs() < 5 / first.numel() ** 0.5
