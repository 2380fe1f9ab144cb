"""Encounters to learn from again."""

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor, nn

from bra.checks.memory import check_memory
from bra.checks.settings import check_count
from bra.randomness.draws import UniformNumbers


class Replay(nn.Module):
    """The last `capacity` triplets (ξ, a, U), as buffers.

    Args:
        capacity: Number of triplets.

    Raises:
        ValueError: If `capacity` is less than 1.
    """

    observation: Tensor
    action: Tensor
    utility: Tensor
    written: Tensor

    def __init__(self, capacity: int) -> None:
        super().__init__()
        self.capacity = check_count(capacity, "memory")
        check_memory(12 * self.capacity, f"memory {capacity:,}")
        self.register_buffer("observation", torch.zeros(0))
        self.register_buffer("action", torch.zeros(capacity, dtype=torch.long))
        self.register_buffer("utility", torch.zeros(capacity))
        self.register_buffer("written", torch.zeros((), dtype=torch.long))

    def make_room(self, space: Space[Any]) -> None:
        """Creates the buffer of signals, with the type of their space."""
        if isinstance(space, Discrete):
            self.observation = torch.zeros(self.capacity, dtype=torch.long)
        else:
            room = np.zeros((self.capacity, *(space.shape or ())), dtype=space.dtype)
            self.observation = torch.from_numpy(room)

    def add(self, observation: Tensor, action: Tensor, utility: Tensor) -> None:
        """Takes encounters in, (B, …) each, over the oldest ones."""
        parts = [part[-self.capacity :] for part in (observation, action, utility)]
        count = len(parts[0])
        place = (self.written + torch.arange(count, device=action.device)) % self.capacity
        for room, part in zip((self.observation, self.action, self.utility), parts, strict=True):
            room[place] = part.to(room.dtype)
        self.written += count

    def draw(
        self, count: int, uniform: UniformNumbers = torch.rand
    ) -> tuple[Tensor, Tensor, Tensor]:
        """`count` triplets drawn with replacement.

        Args:
            count: Number of triplets.
            uniform: Makes numbers in [0, 1), called like `torch.rand`.
        """
        known = self.written.clamp(max=self.capacity)
        numbers = uniform((count,), dtype=self.utility.dtype, device=self.utility.device)
        place = (numbers * known).long()
        return self.observation[place], self.action[place], self.utility[place]
