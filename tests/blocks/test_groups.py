"""Agents in groups are the agents."""

import math

import pytest
import torch

from bra.blocks.groups import GROUP, LINE, give, groups_of, room_for, take, take_updates
from bra.blocks.loop import Packed

CPU = torch.device("cpu")


@pytest.mark.parametrize("size", [1, 2, 255, 256, 257, 300, 512, 1000, 2048, 100_003])
def test_groups_are_of_one_size_and_hold_everybody_once(size):
    groups = groups_of(size, CPU)
    assert [i for group in groups for i in range(size)[group]] == [*range(size)]
    sizes = [group.stop - group.start for group in groups]
    assert sizes[0] <= GROUP and {*sizes[:-1]} <= {sizes[0]} and 0 < sizes[-1] <= sizes[0]
    assert sum(sizes) == size
    assert len(sizes) == 1 or sizes[0] % LINE == 0


def test_few_are_one_group_and_so_are_all_on_other_devices():
    assert groups_of(GROUP, CPU) == [slice(0, GROUP)]
    assert groups_of(5000, torch.device("cuda")) == [slice(0, 5000)]


@pytest.mark.parametrize("size", [1, 2, 256, 300, 1000])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,), (2, 0)])
def test_taken_apart_and_given_back(size, shape):
    tensor = torch.arange(float(size * math.prod(shape))).reshape(size, *shape)
    groups = groups_of(size, CPU)
    room = room_for(groups[0])
    parts = [take(tensor, group, room) for group in groups]
    assert {part.shape for part in parts} == {(*shape, room)}
    assert all(part.stride() == torch.empty(part.shape).stride() for part in parts)
    assert (parts[-1][..., -1] == tensor[-1]).all()
    back = torch.ones_like(tensor)
    give(parts, groups, back)
    assert torch.equal(back, tensor)


def test_updates_are_taken_with_room_for_more():
    worlds = torch.arange(2.0 * 3 * 300).reshape(2, 3, 300)
    taken = take_updates(worlds, slice(200, 300), 112, capacity=5)
    assert taken.shape == (5, 3, 112)
    assert torch.equal(taken[:2, :, :100], worlds[..., 200:])
    assert torch.equal(taken[:2, :, 100:], worlds[..., -1:].expand(2, 3, 12))


@pytest.mark.parametrize(
    ("size", "room"), [(1, 1), (15, 15), (17, 32), (100, 112), (250, 272), (256, 272), (410, 416)]
)
def test_rows_begin_with_lines_of_the_cache_and_not_all_with_the_same_ones(size, room):
    assert room_for(slice(0, size)) == room


def test_what_is_packed_is_what_is_unpacked():
    shapes = [(3, 5), (5,), (), (2, 0, 5), (2, 2, 5), (7,), (), (2, 0)]
    kinds = [torch.float32] * 4 + [torch.float64, torch.float32, torch.int64, torch.float32]
    tensors = [
        (100 * torch.rand(shape)).to(kind) for shape, kind in zip(shapes, kinds, strict=True)
    ]
    packed = Packed(tensors)
    parts = packed.pack(tensors)
    assert sorted((str(part.dtype), *part.shape) for part in parts) == [
        *(("torch.float32", 1, 1), ("torch.float32", 1, 7), ("torch.float32", 2, 0)),
        ("torch.float32", 4, 5),
        *(("torch.float64", 4, 5), ("torch.int64", 1, 1)),
    ]
    assert len(parts) == packed.parts
    for tensor, found in zip(tensors, packed.unpack(parts), strict=True):
        assert found.dtype == tensor.dtype and torch.equal(found, tensor)
