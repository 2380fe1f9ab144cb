"""Blocks of updates: what a learner hands over to compiled code, and takes back."""

import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer

from bra.blocks.groups import give, groups_of, room_for, take, take_updates
from bra.blocks.loop import Inputs, compile_loop
from bra.blocks.modules import Modules
from bra.blocks.optimizers import COUNT, slots_of
from bra.blocks.recording import Channeled, Clip, Recorded, record
from bra.blocks.traces import Untraceable
from bra.tasks.base import Block

LONGEST = 1024
"""Updates of a block at most,"""
NUMBERS = 2**21
"""as long as their worlds are no more numbers than this."""
SECONDS = 0.1
"""What a block is to take."""


@dataclass(frozen=True)
class Many:
    """R agents of the same shape.

    Attributes:
        modules: Of one agent.
        state: Parameters and buffers by name, (R, …) each, which blocks write to.
        optimizers: Of perception and action.
        stacked: Whether what optimizers are given has the dimension R.
        scales: What to multiply each agent's rates by, (2, R).
        keys: Of the streams that updates draw from, (R,).
        own_worlds: Whether each agent has its own worlds.
        clip: Clips gradients of one agent's channel in place, or None.
    """

    modules: Modules
    state: dict[str, Tensor]
    optimizers: Sequence[Optimizer]
    stacked: bool
    scales: Tensor
    keys: Tensor
    own_worlds: bool
    clip: Clip | None

    @property
    def size(self) -> int:
        """R."""
        return len(self.keys)

    def channels(self) -> list[Channeled]:
        """How the parameters of each channel are moved.

        Raises:
            Untraceable: If by something that cannot be recorded.
        """
        names = {tensor.data_ptr(): name for name, tensor in self.state.items() if tensor.numel()}
        found = []
        for optimizer in self.optimizers:
            slots = slots_of(optimizer)
            if isinstance(slots, str):
                raise Untraceable(slots)
            parameters = zip(optimizer.param_groups[0]["params"], slots, strict=True)
            moved = {names[p.data_ptr()]: s for p, s in parameters if p.numel() and p.requires_grad}
            found.append(Channeled(optimizer, tuple(moved), tuple(moved.values())))
        return found


class Blocks:
    """Makes blocks of updates; compiles at the first.

    Args:
        numbers: That the worlds of one update are made of, of all agents.

    Attributes:
        capacity: Updates of a block at most.
        seconds: What an update took in the last block; None before it.
    """

    def __init__(self, numbers: int) -> None:
        self.capacity = max(1, min(LONGEST, NUMBERS // numbers))
        self.seconds: float | None = None
        self._made: list[tuple[Any, Any, Recorded]] = []
        # Compiled code lies in a temporary folder, which goes with it, also when a process ends.
        weakref.finalize(self, self._made.clear)

    @property
    def longest(self) -> int:
        """Updates of the coming block at most, so that it takes no longer than it is to."""
        in_time = max(1, int(SECONDS / self.seconds)) if self.seconds else LONGEST
        return min(self.capacity, in_time)

    def make(
        self, agents: Many, block: Block, prices: Tensor, rates: Callable[[], Tensor]
    ) -> dict[str, Tensor]:
        """Makes the updates of a block, and writes what changes to state and optimizers.

        Args:
            agents: Whose.
            block: Their worlds.
            prices: Of each update, (n, k, R).
            rates: Steps the schedules, and gives the learning rates of each update, (n, 2).

        Returns:
            The terms of J in the last update, (R,) each.

        Raises:
            Untraceable: If they cannot be made so; nothing has changed then.
        """
        channels = agents.channels()
        groups = groups_of(agents.size, agents.keys.device)
        loop, recorded = self._loop(agents, channels, block, prices)
        started = time.perf_counter()
        given = (agents, channels, block, prices, rates(), recorded.constants)
        first, count = (
            torch.tensor(n, device=agents.keys.device) for n in (block.first, block.updates)
        )
        inputs = (self._inputs(*given, group, room_for(groups[0])) for group in groups)
        found = zip(*(loop(first, count, i.kept, i.stacked, i.fixed) for i in inputs), strict=True)
        with torch.no_grad():
            for (live, is_own), changes in zip(
                _live(agents, channels), recorded.changed, strict=True
            ):
                if changes and is_own:
                    give(next(found), groups, live)
                elif changes:
                    live.copy_(next(found)[0])
            terms = {}
            for name, parts in zip(recorded.terms, found, strict=True):
                terms[name] = parts[0].new_empty(agents.size)
                give(parts, groups, terms[name])
        self.seconds = (time.perf_counter() - started) / block.updates
        return terms

    def _loop(
        self, agents: Many, channels: list[Channeled], block: Block, prices: Tensor
    ) -> tuple[Any, Recorded]:
        """The compiled loop, made anew for tensors of another kind."""
        kind = (
            agents.modules.training,
            torch.is_autocast_enabled(prices.device.type),
            *((type(c.optimizer), str(_settings(c.optimizer)), c.names) for c in channels),
            *((t.shape, t.dtype, t.device) for t, _ in _live(agents, channels)),
            *((part.shape[1:], part.dtype) for part in block.world),
            (prices.shape[1:], prices.dtype, prices.device),
        )
        if not self._made or self._made[0][0] != kind:
            recorded, inputs = self._recorded(agents, block, prices)
            loop = compile_loop(recorded, inputs)
            self._made[:] = [(kind, loop, recorded)]
        return self._made[0][1:]

    def _recorded(self, agents: Many, block: Block, prices: Tensor) -> tuple[Recorded, Inputs]:
        """The update of one agent, and inputs of a loop over it, with rates of 0."""
        channels = agents.channels()
        recorded = self._record(agents, channels, block, prices)
        rates = torch.zeros(block.updates, 2, dtype=prices.dtype, device=prices.device)
        group, *_ = groups_of(agents.size, agents.keys.device)
        given = (agents, channels, block, prices, rates, recorded.constants)
        return recorded, self._inputs(*given, group, room_for(group))

    def _inputs(
        self,
        agents: Many,
        channels: Sequence[Channeled],
        block: Block,
        prices: Tensor,
        rates: Tensor,
        constants: Sequence[Tensor],
        group: slice,
        room: int,
    ) -> Inputs:
        live, own_worlds = _live(agents, channels), agents.own_worlds
        of_updates = partial(take_updates, group=group, room=room, capacity=self.capacity)
        worlds = [
            of_updates(part.movedim(1, -1)) if own_worlds else self._room_for_updates(part)
            for part in block.world
        ]
        scales = take(agents.scales.T, group, room)
        fixed = (scales, take(agents.keys, group, room), *map(_packed, constants))
        own = [
            *(is_own for _, is_own in live),
            *(True, True, False, own_worlds, own_worlds, False, True),
            *repeat(False, len(constants)),
        ]
        kept = [
            take(tensor.detach(), group, room) if is_own else _packed(tensor)
            for tensor, is_own in live
        ]
        stacked = (of_updates(prices), self._room_for_updates(rates), *worlds)
        return Inputs(tuple(kept), stacked, fixed, tuple(own), room)

    def _room_for_updates(self, tensor: Tensor) -> Tensor:
        """(n, …) to (capacity, …)."""
        room = tensor.new_empty(self.capacity, *tensor.shape[1:])
        room[: len(tensor)] = tensor
        return room

    def _record(
        self, agents: Many, channels: list[Channeled], block: Block, prices: Tensor
    ) -> Recorded:
        """The first agent's update."""
        of_one = [
            Channeled(
                c.optimizer,
                c.names,
                tuple({n: self._first(t, n, agents) for n, t in s.items()} for s in c.slots),
            )
            for c in channels
        ]
        world = [part[0, 0] if agents.own_worlds else part[0] for part in block.world]
        rates = torch.ones(2, dtype=prices.dtype, device=prices.device)
        count = torch.zeros((), dtype=torch.long, device=prices.device)
        inputs = (prices[0, :, 0], rates, rates, *world, count, agents.keys[0])
        state = {name: tensor[0] for name, tensor in agents.state.items()}
        return record(agents.modules, state, of_one, inputs, agents.clip)

    def _first(self, slot: Tensor, name: str, agents: Many) -> Tensor:
        return slot[0] if agents.stacked and name != COUNT else slot


def _settings(optimizer: Optimizer) -> dict[str, Any]:
    """The settings of an optimizer apart from its rate."""
    return {k: v for k, v in optimizer.param_groups[0].items() if k not in ("params", "lr")}


def _live(agents: Many, channels: Sequence[Channeled]) -> list[tuple[Tensor, bool]]:
    """State and slots, with the dimension R in front where each agent has its own."""
    found = [(tensor, True) for tensor in agents.state.values()]
    for channel in channels:
        for slots in channel.slots:
            for name, slot in slots.items():
                own = name != COUNT
                found.append((slot if agents.stacked or not own else slot.unsqueeze(0), own))
    return found


def _packed(tensor: Tensor) -> Tensor:
    """A copy whose strides are those of its shape, also where a dimension is 1."""
    return torch.empty(tensor.shape, dtype=tensor.dtype, device=tensor.device).copy_(tensor)
