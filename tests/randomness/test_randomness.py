"""Random numbers that are counted, not carried."""

from itertools import product

import pytest
import torch

from bra.randomness.generators import counted, counted_generator, counted_seed

CPU = torch.device("cpu")
# BLAKE2b of "seed/update/place", 8 bytes big-endian, halved.
PINNED = {
    (0, 0, "world"): 8_893_661_175_627_579_452,
    (42, 1000, "update"): 1_027_620_767_312_830_202,
}


def draw(seed=0, update=0, place="world"):
    with counted(seed, update, place, CPU):
        return torch.rand(4)


@pytest.mark.parametrize(("seed", "update", "place"), [(0, 0, "world"), (3, 10**6, "update 1")])
def test_equal_counts_give_equal_draws(seed, update, place):
    first = draw(seed, update, place)
    torch.rand(17)  # somebody else draws meanwhile
    assert torch.equal(first, draw(seed, update, place))
    generators = [counted_generator(seed, update, place) for _ in range(2)]
    assert torch.equal(*(torch.rand(4, generator=generator) for generator in generators))


def test_default_generators_and_own_generators_draw_the_same():
    generator = counted_generator(5, 6, "world")
    assert torch.equal(draw(5, 6, "world"), torch.rand(4, generator=generator))


def test_every_seed_update_and_place_draws_its_own():
    # Seeds are hashes of 63 bits: two of 400 are equal with probability 1e-14.
    places = ("world", "update", "update 1", "predict")
    cells = list(product((0, 1, 2, 10, 11), (*range(19), 10**9), places))
    assert len({counted_seed(*cell) for cell in cells}) == len(cells)
    assert len({tuple(draw(*cell).tolist()) for cell in cells}) == len(cells)


def test_digits_do_not_run_together():
    # Distinct up to a hash collision, probability 1e-19.
    assert counted_seed(1, 11, "world") != counted_seed(11, 1, "world")
    assert counted_seed(1, 1, "1/world") != counted_seed(1, 11, "world")
    assert counted_seed(-1, 1, "world") != counted_seed(1, -1, "world")


def test_seeds_are_the_same_on_every_machine():
    # Runs of old checkpoints depend on it.
    assert counted_seed(0, 0, "world") == PINNED[0, 0, "world"]
    assert counted_seed(42, 1000, "update") == PINNED[42, 1000, "update"]
    assert all(0 <= seed < 2**63 for seed in PINNED.values())


def test_the_outer_state_comes_back():
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    draw()
    assert torch.equal(torch.rand(3), expected)


def test_the_outer_state_comes_back_after_an_error():
    before = torch.get_rng_state()
    with pytest.raises(RuntimeError, match="inside"), counted(0, 0, "world", CPU):
        torch.rand(1)
        raise RuntimeError("inside")
    assert torch.equal(torch.get_rng_state(), before)


def test_counted_blocks_nest():
    alone = draw(0, 1, "outer")
    with counted(0, 1, "outer", CPU):
        inner = draw(0, 1, "inner")
        assert torch.equal(torch.rand(4), alone)
    assert torch.equal(inner, draw(0, 1, "inner"))
