"""What an update rule is: a loss for one batch of worlds."""

from abc import ABC, abstractmethod
from typing import ClassVar

from torch import Tensor, nn

from bra.chain import Chain
from bra.checkpoints.recipes import Rebuildable
from bra.objective import Objective
from bra.tasks import World


class UpdateRule(Rebuildable, nn.Module, ABC):
    """Turns a batch of worlds into a loss whose gradient moves both channels.

    The agent back-propagates the loss once and steps each channel's own optimizer. Buffers that a
    rule registers belong to the checkpoint.
    """

    looks: ClassVar[bool] = False
    """Whether the rule trains actions that look at the signal again."""

    def check(self, chain: Chain) -> None:
        """Raises ValueError if the rule cannot train such a chain, saying which rule can."""

    def metrics(self) -> dict[str, float]:
        """What a rule has to say of itself, by logged name; nothing by default."""
        return {}

    def settle(self, run: int) -> None:
        """Turns what is a share of a run into updates; called when a run of so many begins."""

    def sees_worlds(self, chain: Chain) -> bool:
        """Whether the loss depends on the batch of worlds, and not on the task alone."""
        return True

    @abstractmethod
    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """The loss to descend, a scalar, and the terms of J as this update saw them."""
