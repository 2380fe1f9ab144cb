"""Whether one update can stand for all: it leaves no trace but in what it is given."""

import copy
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from bra.blocks.modules import Modules
from bra.randomness.generators import drawing_by_default

MUTABLE = (dict, list, set)
TORCHS = frozenset(vars(nn.Module()))
"""What every module has, of which parameters and buffers belong to the state."""


class Untraceable(Exception):
    """What an update does cannot be recorded; says why."""


@dataclass(frozen=True)
class Memory:
    """An attribute that is no buffer.

    Attributes:
        owner: Whose.
        name: Of the attribute.
        value: As it was; what can be changed in place, as a copy.
        version: Of a tensor, by which it tells of changes.
    """

    owner: Any
    name: str
    value: Any
    version: int

    def same(self) -> bool:
        """Whether it is still what it was."""
        now = vars(self.owner).get(self.name)
        if now is self.value or isinstance(now, Tensor):
            return now is self.value and _version(now) == self.version
        try:
            return bool(now == self.value)
        except (RuntimeError, TypeError, ValueError):  # of arrays, say
            return False

    def restore(self) -> None:
        """Puts it back."""
        if not isinstance(self.value, Tensor):
            vars(self.owner)[self.name] = self.value


@contextmanager
def nothing_else_changes(
    modules: Modules, device: torch.device, once: Callable[[], None]
) -> Iterator[None]:
    """Within, an update is recorded, which must be the same whenever it is made.

    Args:
        modules: Of the agent.
        device: Where they are.
        once: Makes the update's loss before, so that what is worked out once is no change.

    Raises:
        Untraceable: If something changes within that is no parameter or buffer, or random numbers
            are drawn from others' generators. Attributes are then as they were.
    """
    python, numpy = random.getstate(), np.random.get_state()
    start = _memories(modules)
    try:
        with drawing_by_default(device) as drawn:
            once()
            before = _memories(modules)
            yield
        changed = [memory for memory in before if not memory.same()]
        if drawn() or random.getstate() != python or repr(np.random.get_state()) != repr(numpy):
            raise Untraceable("it draws from default generators")
        if changed:
            owner, name = type(changed[0].owner).__name__, changed[0].name
            raise Untraceable(f"{owner}.{name} changes from update to update and is no buffer")
    except BaseException:
        random.setstate(python)
        np.random.set_state(numpy)
        known = {(id(memory.owner), memory.name) for memory in start}
        for memory in _memories(modules):
            if (id(memory.owner), memory.name) not in known:
                delattr(memory.owner, memory.name)
        for memory in start:
            memory.restore()
        raise


def _memories(modules: Modules) -> list[Memory]:
    """What modules and task remember beside their state."""
    owners = [*modules.modules(), *([] if isinstance(modules.task, nn.Module) else [modules.task])]
    return [
        Memory(
            owner, name, copy.copy(value) if isinstance(value, MUTABLE) else value, _version(value)
        )
        for owner in owners
        for name, value in vars(owner).items()
        if name not in TORCHS and not isinstance(value, nn.Module)
    ]


def _version(value: Any) -> int:
    known = isinstance(value, Tensor) and not value.is_inference()
    return value._version if known else 0
