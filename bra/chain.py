"""The chain Ω → X → A: channels, marginals and prices as one object."""

from dataclasses import dataclass
from typing import Protocol, Self

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import draw, log_probabilities
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
        *,
        update: int = 0,
        uniform: UniformNumbers = torch.rand,
    ) -> Self:
        """The chain of an agent's parts at given prices, with the random numbers of an update."""
        parts = (wired.task, wired.perception, wired.action, wired.marginals)
        return cls(*parts, beta_perception, beta_action, beta_direct, update, uniform)

    @property
    def looks(self) -> bool:
        """Whether actions look at the signal again."""
        return self.beta_direct is not None

    def act(self, percept: Tensor, observation: Tensor) -> Distribution:
        """p(a|x), or p(a|x,ξ) where actions look at the signal again, of the percepts' shape."""
        given: Distribution = self.action((percept, observation) if self.looks else percept)
        return given

    def second_look(self, observation: Tensor) -> Distribution:
        """p(a|x,ξ) for all percepts and signals (C, …), batch shape (X, C)."""
        count, percepts = len(observation), feature_count(self.perception.outcome_space)
        percept = torch.arange(percepts, device=observation.device).unsqueeze(-1)
        return self.act(percept.expand(-1, count), observation.expand(percepts, *observation.shape))

    def responses(self, observation: Tensor) -> Distribution:
        """p(a|x), batch shape (X,), or p(a|x,ξ), (X, C), where actions look again."""
        return self.second_look(observation) if self.looks else self.action.forward_all()

    def shared_action(self, observation: Tensor) -> Distribution:
        """p(a|x), the mean of p(a|x,ξ) over the signals of x, batch shape (X,).

        Args:
            observation: ξ of the batch, which marginals that are not exact are means over.
        """
        observation, weight = self.marginals.signals(self.task, observation)
        log_percept = log_probabilities(self.perception(observation))
        log_joint = weight.log().unsqueeze(-1) + log_percept
        return self.marginals.shared_action(log_joint, self.second_look(observation))

    def draw(self, distribution: Distribution, shape: tuple[int, ...] = ()) -> Tensor:
        """Draws outcomes, (*shape, *batch shape, *event shape).

        Rules that draw nothing but this way can be trained as a `bra.Population` in one go.
        """
        return draw(distribution, shape, self.uniform)
