"""Which agents a block takes together, and how they lie in memory."""

import torch
from torch import Tensor

GROUP = 256
"""Agents at most whose updates are made side by side on a CPU.

What some hundred agents have stays in the cache of a core from update to update; what thousands
have does not. Agents know nothing of each other, so that one group makes all updates of a block
before the next one begins.
"""
ALIASED = 256
"""Numbers in float32 that are a kilobyte."""
SPARE = 16
"""Numbers in float32 that are a line of the cache."""


def groups_of(size: int, device: torch.device) -> list[slice]:
    """R agents in groups of the same size, but for the last one, which may be smaller."""
    count = 1 if device.type != "cpu" else -(-size // GROUP)
    each = -(-size // count)
    return [slice(first, min(first + each, size)) for first in range(0, size, each)]


def room_for(group: slice) -> int:
    """R′, the agents for whom there is room in memory, of the first group and so of all.

    A loop over what each of R agents has goes through memory in steps of R numbers. If these are a
    whole number of kilobytes, all that it reads competes for a few lines of the cache.
    """
    size: int = group.stop - group.start
    return size + SPARE if size % ALIASED == 0 else size


def take(tensor: Tensor, group: slice, room: int) -> Tensor:
    """What a group has of (…, R), as (…, R′): the last agent stands for those that are missing."""
    own = tensor[..., group]
    missing = room - own.shape[-1]
    if not missing:
        return own
    return torch.cat([own, own[..., -1:].expand(*own.shape[:-1], missing)], -1)


def join(parts: tuple[Tensor, ...], groups: list[slice]) -> Tensor:
    """(…, R) from what each group has, (…, R′)."""
    own = zip(parts, groups, strict=True)
    return torch.cat([part[..., : group.stop - group.start] for part, group in own], -1)
