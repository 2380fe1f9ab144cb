"""The chain Ω → X → A: channels, marginals and prices as one object."""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import draw
from bra.marginals import Marginals
from bra.objective import Price
from bra.randomness.draws import UniformNumbers
from bra.tasks import Task


class Wired(Protocol):
    """What holds the parts of a chain: an agent, or the modules of one."""

    task: Task
    perception: Channel
    action: Channel
    marginals: Marginals


@dataclass(frozen=True)
class Chain:
    """Ω → X → A: what a rule trains, and what `bra.evaluation.evaluate` judges.

    Attributes:
        task: What draws ω and ξ, and gives U(ω, a).
        perception: p(x|ξ).
        action: p(a|x).
        marginals: The way to p(x) and p(a).
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
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
    uniform: UniformNumbers = torch.rand

    @classmethod
    def of(cls, wired: Wired, beta_perception: Price, beta_action: Price) -> Self:
        """The chain of an agent's parts at given prices."""
        parts = (wired.task, wired.perception, wired.action, wired.marginals)
        return cls(*parts, beta_perception, beta_action)

    def at(self, update: int, uniform: UniformNumbers) -> Self:
        """The same for an update, with the random numbers that belong to it."""
        return replace(self, update=update, uniform=uniform)

    def draw(self, distribution: Distribution, shape: tuple[int, ...] = ()) -> Tensor:
        """Draws outcomes, (*shape, *batch shape, *event shape).

        Rules that draw nothing but this way can be trained as a `bra.Population` in one go.
        """
        return draw(distribution, shape, self.uniform)
