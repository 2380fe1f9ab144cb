"""Uniform random numbers that are a function of seed, stream, update and position."""

import pytest
import torch

from bra.randomness.draws import AHEAD, Streams, Uniform, to_unit
from bra.randomness.keys import split, stream_keys, update_key

CPU = torch.device("cpu")


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
        alone = Uniform(update_key(seed, "update", 11))
        assert all(torch.equal(block[index], alone(block.shape[1:])) for block in together)


def test_blocks_follow_each_other():
    parts, whole = (Uniform(update_key(0, "update", 3)) for _ in range(2))
    assert torch.equal(torch.cat([parts((3,)), parts((2,))]), whole((5,)))


def test_default_generators_are_left_alone():
    before = torch.get_rng_state()
    draw_together((0, 1), 0, (5,))
    Uniform(0)((5,))
    Streams([0, 1], "world").uniform(0, 5)
    assert torch.equal(before, torch.get_rng_state())


def test_numbers_of_a_stream_do_not_depend_on_what_was_asked_before():
    streams = Streams([3, 4], "world")
    updates = (0, AHEAD - 1, AHEAD, 10**9, 1)
    found = [streams.uniform(update, 2) for update in updates]
    for update, numbers in zip(updates, found, strict=True):
        assert torch.equal(numbers, Streams([3, 4], "world").uniform(update, 2))
        assert torch.equal(numbers[1:], Streams([4], "world").uniform(update, 2))
        alone = Uniform(update_key(4, "world", update))
        assert torch.equal(numbers[1], alone((2,), torch.double))


SIDE = 256
AXES = {
    "positions": lambda: Uniform(update_key(0, "update", 0))((SIDE, SIDE), torch.double),
    "updates": lambda: torch.stack(
        [Uniform(update_key(0, "update", k))((SIDE,), torch.double) for k in range(SIDE)]
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
