"""Torch's generators for what draws by nothing else, seeded with the keys of updates."""

import pytest
import torch

from bra.randomness.generators import counted, counted_generator

CPU = torch.device("cpu")


def draw(seed=0, update=0, stream="world"):
    with counted(seed, update, stream, CPU):
        return torch.rand(4)


@pytest.mark.parametrize(("seed", "update", "stream"), [(0, 0, "world"), (3, 10**6, "update 1")])
def test_equal_counts_give_equal_draws(seed, update, stream):
    first = draw(seed, update, stream)
    torch.rand(17)  # somebody else draws meanwhile
    assert torch.equal(first, draw(seed, update, stream))
    generators = [counted_generator(seed, update, stream) for _ in range(2)]
    assert torch.equal(*(torch.rand(4, generator=generator) for generator in generators))


def test_default_generators_and_own_generators_draw_the_same():
    generator = counted_generator(5, 6, "world")
    assert torch.equal(draw(5, 6, "world"), torch.rand(4, generator=generator))


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
