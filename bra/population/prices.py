"""The prices of many agents."""

from collections.abc import Sequence

import torch
from torch import Tensor

from bra.agent.settings import Setting
from bra.cooling import Cooling

Pair = tuple[Tensor, Tensor]
"""β₁ and β₂, (R,) each."""


class Prices:
    """β₁ and β₂ of R agents, float64 whatever the precision of their channels.

    Tensors that it gives are kept, since small populations would feel the making of them in every
    update; they are not to be changed.

    Args:
        settings: Of the agents.
        cooling: How the prices of updates approach the agents' own.
    """

    def __init__(self, settings: Sequence[Setting], cooling: Cooling | None) -> None:
        self.cooling = cooling
        self._own = torch.tensor([s.prices for s in settings], dtype=torch.double).T.contiguous()
        self._seeds = [setting.seed for setting in settings]
        self._kept: dict[tuple[torch.device, torch.dtype], Pair] = {}

    def own(self, device: torch.device, dtype: torch.dtype = torch.double) -> Pair:
        """What the agents pay, and are judged by."""
        if (device, dtype) not in self._kept:
            perception, action = self._own.to(device, dtype)
            self._kept[device, dtype] = perception, action
        return self._kept[device, dtype]

    def at(self, update: int, device: torch.device, dtype: torch.dtype = torch.double) -> Pair:
        """What `update`, counted from 0, sees: cooled in float64, then rounded to `dtype`."""
        if not (self.cooling and self.cooling.exponent(update)):
            return self.own(device, dtype)
        perception, action = self.along([update])[0].to(device, dtype)
        return perception, action

    def along(self, updates: Sequence[int]) -> Tensor:
        """The same of several updates, (n, 2, R), float64."""
        if self.cooling is None:
            return self._own.expand(len(updates), -1, -1)
        return self.cooling.along(self._own, updates, self._seeds)
