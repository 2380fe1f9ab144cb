"""What an update rule is: a loss for one batch of worlds."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import draw
from bra.checkpoints.recipes import Rebuildable
from bra.marginals import Marginals
from bra.objective import Objective, Price
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
        update: Number of the update, counted from 0; in a compiled population a tensor of shape (),
            which control flow cannot depend on.
        uniform: Where uniform random numbers come from: `torch.rand`, or something that is called
            like it.
    """

    task: Task
    perception: Channel
    action: Channel
    marginals: Marginals
    beta_perception: Price
    beta_action: Price
    update: int = 0
    uniform: Callable[..., Tensor] = torch.rand

    def draw(self, distribution: Distribution, shape: tuple[int, ...] = ()) -> Tensor:
        """Draws outcomes, (*shape, *batch shape, *event shape).

        Rules that draw nothing but this way can be trained as a `bra.Population` in one go.
        """
        return draw(distribution, shape, self.uniform)


class UpdateRule(Rebuildable, nn.Module, ABC):
    """Turns a batch of worlds into a loss whose gradient moves both channels.

    The agent back-propagates the loss once and steps each channel's own optimizer. Buffers that a
    rule registers belong to the checkpoint.
    """

    def check(self, chain: Chain) -> None:
        """Raises ValueError if the rule cannot train such a chain, saying which rule can."""

    def metrics(self) -> dict[str, float]:
        """What a rule has to say of itself, by logged name; nothing by default."""
        return {}

    def sees_worlds(self, chain: Chain) -> bool:
        """Whether the loss depends on the batch of worlds, and not on the task alone."""
        return True

    @abstractmethod
    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """The loss to descend, a scalar, and the terms of J as this update saw them."""
