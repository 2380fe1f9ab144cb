"""Agents in groups are the agents."""

import pytest
import torch

from bra.blocks.groups import GROUP, groups_of, join, room_for, take

CPU = torch.device("cpu")


@pytest.mark.parametrize("size", [1, 2, 255, 256, 257, 300, 512, 1000, 2048, 100_003])
def test_groups_are_of_one_size_and_hold_everybody_once(size):
    groups = groups_of(size, CPU)
    assert [i for group in groups for i in range(size)[group]] == [*range(size)]
    sizes = [group.stop - group.start for group in groups]
    assert sizes[0] <= GROUP and {*sizes[:-1]} <= {sizes[0]} and 0 < sizes[-1] <= sizes[0]
    assert sum(sizes) == size


def test_few_are_one_group_and_so_are_all_on_other_devices():
    assert groups_of(GROUP, CPU) == [slice(0, GROUP)]
    assert groups_of(5000, torch.device("cuda")) == [slice(0, 5000)]


@pytest.mark.parametrize("size", [1, 256, 300])
def test_taken_apart_and_joined(size):
    tensor = torch.arange(3.0 * size).reshape(3, size)
    groups = groups_of(size, CPU)
    room = room_for(groups[0])
    parts = [take(tensor, group, room) for group in groups]
    assert {part.shape for part in parts} == {(3, room)}
    assert room % 256
    assert (parts[-1][:, -1] == tensor[:, -1]).all()
    assert torch.equal(join(tuple(parts), groups), tensor)
