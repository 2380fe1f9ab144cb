"""The prices of many agents."""

from collections.abc import Sequence

import torch
from torch import Tensor

from bra.agent.settings import Setting
from bra.cooling import Cooling

Betas = tuple[Tensor, ...]
"""β₁, β₂ and, where actions look at the signal again, β₃, (R,) each."""


class Prices:
    """β₁, β₂ and β₃ of R agents, float64 whatever the precision of their channels.

    Tensors that it gives are kept, since small populations would feel the making of them in every
    update; they are not to be changed.

    Args:
        settings: Of the agents.
        cooling: How the prices of updates approach the agents' own.
        beta_direct: β₃ of all of them, or None.
    """

    def __init__(
        self, settings: Sequence[Setting], cooling: Cooling | None, beta_direct: float | None = None
    ) -> None:
        self.cooling = cooling
        direct = () if beta_direct is None else (beta_direct,)
        own = torch.tensor([(*s.prices, *direct) for s in settings], dtype=torch.double)
        self._own = own.T.contiguous()
        self._seeds = [setting.seed for setting in settings]
        self._kept: dict[tuple[torch.device, torch.dtype], Betas] = {}

    def own(self, device: torch.device, dtype: torch.dtype = torch.double) -> Betas:
        """What the agents pay, and are judged by."""
        if (device, dtype) not in self._kept:
            self._kept[device, dtype] = tuple(self._own.to(device, dtype))
        return self._kept[device, dtype]

    def at(self, update: int, device: torch.device, dtype: torch.dtype = torch.double) -> Betas:
        """What `update`, counted from 0, sees: cooled in float64, then rounded to `dtype`."""
        if not (self.cooling and self.cooling.exponent(update)):
            return self.own(device, dtype)
        return tuple(self.along([update])[0].to(device, dtype))

    def along(self, updates: Sequence[int]) -> Tensor:
        """The same of several updates, (n, k, R), float64."""
        if self.cooling is None:
            return self._own.expand(len(updates), -1, -1)
        return self.cooling.along(self._own, updates, self._seeds)
