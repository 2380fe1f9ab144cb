"""Which agents a block takes together, and how they lie in memory."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

GROUP = 448
"""Agents at most whose updates are made side by side on a CPU.

What some hundred agents have stays in the cache of a core from update to update; what thousands
have does not. Agents know nothing of each other, so that one group makes all updates of a block
before the next one begins.
"""
ALIASED = 256
"""Numbers in float32 that are a kilobyte."""
LINE = 16
"""Numbers in float32 that are a line of the cache, and the longest vector."""


def groups_of(size: int, device: torch.device) -> list[slice]:
    """R agents in groups of the same size, but for the last one, which may be smaller.

    Where there are several, they are of whole lines, so that few rooms have to be filled.
    """
    count = 1 if device.type != "cpu" else -(-size // GROUP)
    each = -(-size // count)
    each = -(-each // LINE) * LINE if count > 1 else size
    return [slice(first, min(first + each, size)) for first in range(0, size, each)]


def room_for(group: slice) -> int:
    """R′, the agents for whom there is room in memory, of the first group and so of all.

    Whole lines of the cache, so that no vector lies across two. A loop over what each of R agents
    has goes through memory in steps of R numbers. If these are a whole number of kilobytes, all
    that it reads competes for a few lines of the cache.
    """
    size: int = group.stop - group.start
    if size > LINE:
        size = -(-size // LINE) * LINE
    return size + LINE if size % ALIASED == 0 else size


def take(tensor: Tensor, group: slice, room: int) -> Tensor:
    """What a group has of (R, …), as (…, R′): the last agent stands for those that are missing."""
    own = tensor[group]
    if room > len(own):
        own = torch.cat([own, own[-1:].expand(room - len(own), *own.shape[1:])])
    rows = own.reshape(room, math.prod(tensor.shape[1:]))
    # Whole matrices are turned over several times as fast as views of them.
    turned = rows.new_empty(rows.shape[1], room).copy_(rows.T)
    return turned.view(*tensor.shape[1:], room)


def take_updates(tensor: Tensor, group: slice, room: int, capacity: int) -> Tensor:
    """The same of (n, …, R) for each of n updates, as (capacity, …, R′)."""
    own = tensor[..., group]
    taken = tensor.new_empty(capacity, *own.shape[1:-1], room)
    taken[: len(own), ..., : own.shape[-1]] = own
    taken[: len(own), ..., own.shape[-1] :] = own[..., -1:]
    return taken


def give(parts: Sequence[Tensor], groups: Sequence[slice], tensor: Tensor) -> None:
    """Writes what each group has, (…, R′), to (R, …)."""
    for part, group in zip(parts, groups, strict=True):
        columns = part.reshape(math.prod(part.shape[:-1]), part.shape[-1])
        turned = columns.new_empty(columns.T.shape).copy_(columns.T)
        tensor[group] = turned[: group.stop - group.start].view(tensor[group].shape)
