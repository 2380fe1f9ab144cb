"""What an update rule is: a loss for one batch of worlds."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from torch import Tensor, nn

from bra.channels import Channel
from bra.marginals import Marginals
from bra.objective import Objective
from bra.recipes import Rebuildable
from bra.tasks import Task, World


@dataclass(frozen=True)
class Chain:
    """The chain Ω → X → A that a rule trains, with its prices.

    Attributes:
        task: What draws ω and ξ, and gives U(ω, a).
        perception: p(x|ξ).
        action: p(a|x).
        marginals: The way to p(x) and p(a).
        beta_perception: β₁ of the update, per nat.
        beta_action: β₂ of the update, per nat.
    """

    task: Task
    perception: Channel
    action: Channel
    marginals: Marginals
    beta_perception: float
    beta_action: float


class UpdateRule(Rebuildable, nn.Module, ABC):
    """Turns a batch of worlds into a loss whose gradient moves both channels.

    The agent back-propagates the loss once and steps each channel's own optimizer. Buffers that a
    rule registers belong to the checkpoint.
    """

    def check(self, chain: Chain) -> None:
        """Raises ValueError if the rule cannot train such a chain, saying which rule can."""

    @abstractmethod
    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """The loss to descend, a scalar, and the terms of J as this update saw them."""
