"""The chain Ω → X → A: channels, marginals and prices as one object."""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import draw
from bra.channels.spaces import feature_count
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
        beta_direct: β₃, per nat, where the action is p(a|x,ξ) and looks at the signal again.
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
    beta_direct: Price | None = None
    update: int = 0
    uniform: UniformNumbers = torch.rand

    @classmethod
    def of(
        cls,
        wired: Wired,
        beta_perception: Price,
        beta_action: Price,
        beta_direct: Price | None = None,
    ) -> Self:
        """The chain of an agent's parts at given prices."""
        parts = (wired.task, wired.perception, wired.action, wired.marginals)
        return cls(*parts, beta_perception, beta_action, beta_direct)

    def at(self, update: int, uniform: UniformNumbers) -> Self:
        """The same for an update, with the random numbers that belong to it."""
        return replace(self, update=update, uniform=uniform)

    def second_look(self, observation: Tensor) -> Distribution:
        """p(a|x,ξ) for signals (C, …) and all percepts, batch shape (C, X)."""
        count, percepts = len(observation), feature_count(self.perception.outcome_space)
        percept = torch.arange(percepts, device=observation.device).expand(count, -1)
        again = observation.unsqueeze(1).expand(count, percepts, *observation.shape[1:])
        given: Distribution = self.action((percept, again))
        return given

    def draw(self, distribution: Distribution, shape: tuple[int, ...] = ()) -> Tensor:
        """Draws outcomes, (*shape, *batch shape, *event shape).

        Rules that draw nothing but this way can be trained as a `bra.Population` in one go.
        """
        return draw(distribution, shape, self.uniform)
