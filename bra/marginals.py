"""The marginals p(x) and p(a) under the current channels.

What differs between rules is only how p(x) comes about, for which there are three ways here;
p(a) = Σ_x p(x) p(a|x) follows from it and the action channel.
"""

from abc import ABC, abstractmethod
from typing import Any

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor, nn
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import Categorical, mixture, probabilities
from bra.checkpoints.recipes import Rebuildable
from bra.tasks import FiniteStateTask, Task, knows_signals

FRESH = 512
"""Percepts that p(a) is averaged over where they cannot be enumerated."""


class Marginals(Rebuildable, nn.Module, ABC):
    """A way to p(x)."""

    def check(self, task: Task, percept_space: Space[Any]) -> None:
        """Raises ValueError if this way does not lead to p(x) for such a task and percepts."""

    @abstractmethod
    def percept(
        self, task: Task, perception: Channel, percept_given: Distribution, device: torch.device
    ) -> Distribution:
        """p(x), batch shape ().

        Args:
            task: What the agent does.
            perception: The perception channel.
            percept_given: p(x|ξ) of the current batch, batch shape (B,).
            device: Where the channels are.
        """

    def information_lost(self, count: int) -> float:
        """By what share of χ²(ξ;X) batches of `count` signals find I(ξ;X) too small, in nats.

        χ²(ξ;X) = Σ_x Var[p(x|ξ)] / p(x) is at most |X| − 1. 0 where p(x) is exact.
        """
        return 0.0

    def action(self, action: Channel, percept_marginal: Distribution) -> Distribution:
        """p(a) = Σ_x p(x) p(a|x), batch shape ().

        Where percepts cannot be enumerated p(a|x) is averaged over K = `FRESH` of them, drawn from
        p(x) anew: percepts that an update acts on would be part of their own marginal, and a single
        one would cost nothing. Since E[−log p̂(a)] ≈ −log p(a) + Var[p(a|x)] / (2K p(a)²), actions
        cost too much by χ²(X;A)/(2K) nats to first order.

        Args:
            action: The action channel.
            percept_marginal: p(x).
        """
        if percept_marginal.has_enumerate_support:
            return mixture(probabilities(percept_marginal), action.forward_all())
        percepts = percept_marginal.sample((FRESH,))
        return mixture(percepts.new_full((FRESH,), 1 / FRESH), action(percepts))


class ExactMarginals(Marginals):
    """p(x) = Σ_ω p(ω) p(x|ω) over all states, for known states and a noiseless sensor."""

    def check(self, task: Task, percept_space: Space[Any]) -> None:
        """Asks for a `FiniteStateTask` with a noiseless sensor."""
        if not knows_signals(task):
            lack = (
                "a noiseless sensor"
                if isinstance(task, FiniteStateTask)
                else "a task with known states"
            )
            raise ValueError(
                f"ExactMarginals need {lack}, got {type(task).__name__}; "
                "use BatchMarginals or RunningMarginals"
            )

    def percept(
        self, task: Task, perception: Channel, percept_given: Distribution, device: torch.device
    ) -> Distribution:
        """p(x), exact."""
        assert isinstance(task, FiniteStateTask)  # check() saw to it
        components = perception(task.states().observation.to(device))
        return mixture(task.prior.to(device, torch.get_default_dtype()), components)


class BatchMarginals(Marginals):
    """p(x) ≈ (1/B) Σ_i p(x|ξ_i) over the B ≥ 2 world-states of the current batch.

    Since each p(x|ξ_i) is part of its own marginal, E[I(ξ;X)] comes out low by χ²(ξ;X)/(2B) nats to
    first order, where χ²(ξ;X) = Σ_x Var[p(x|ξ)] / p(x); hence batches of 25 or more.
    """

    def information_lost(self, count: int) -> float:
        """1/(2B); see `Marginals.information_lost`."""
        return 0.5 / count

    def percept(
        self, task: Task, perception: Channel, percept_given: Distribution, device: torch.device
    ) -> Distribution:
        """p(x) of the batch."""
        (count,) = percept_given.batch_shape
        if count < 2:
            raise ValueError(
                "BatchMarginals need batches of at least 2 world-states, got 1, whose information "
                "would cost nothing; use ExactMarginals or RunningMarginals"
            )
        return mixture(torch.full((count,), 1 / count, device=device), percept_given)


class RunningMarginals(Marginals):
    """p(x) ∝ Σ_k d^(now − k) (1/B) Σ_i p(x|ξ_i): batches averaged over some 1/(1 − d) updates.

    The average starts from nothing and is normalised whenever it is used. It belongs to the
    checkpoint.

    A signal's own row weighs w = (1 − d)/B in the average, and the squares of all weights sum to
    w/(1 + d). So E[I(ξ;X)] comes out low by χ²(ξ;X) w (1 − ½/(1 + d)) nats to first order, while
    the channels stand still: with B = 1 by 0.015 χ² at d = 0.98, by 0.07 χ² at 0.9, by 0.33 χ² at
    0.5, where χ²(ξ;X) = Σ_x Var[p(x|ξ)] / p(x) ≤ |X| − 1. Small batches need a high decay.

    Args:
        decay: d, at least 0 and less than 1.

    Raises:
        ValueError: If `decay` is outside.
    """

    average: Tensor

    def __init__(self, decay: float = 0.98) -> None:
        super().__init__()
        if not 0 <= decay < 1:
            raise ValueError(f"decay must be at least 0 and less than 1, got {decay}")
        self.decay = decay
        self.register_buffer("average", torch.zeros(0))

    def check(self, task: Task, percept_space: Space[Any]) -> None:
        """Asks for discrete percepts, and makes room for them."""
        if not isinstance(percept_space, Discrete):
            raise ValueError(
                f"RunningMarginals need Discrete percepts, got {percept_space}; "
                "use BatchMarginals, or ExactMarginals where the states are known"
            )
        self.average = torch.zeros(int(percept_space.n))

    def information_lost(self, count: int) -> float:
        """That is w (1 − ½/(1 + d)); see `Marginals.information_lost`."""
        return (1 - self.decay) / count * (1 - 0.5 / (1 + self.decay))

    def percept(
        self, task: Task, perception: Channel, percept_given: Distribution, device: torch.device
    ) -> Distribution:
        """p(x), after this batch has been averaged in."""
        batch = probabilities(percept_given).detach().mean(0)
        self.average.mul_(self.decay).add_(batch, alpha=1 - self.decay)  # vmap knows no lerp_
        return Categorical(self.average / self.average.sum())


def default_marginals(task: Task, percept_space: Space[Any]) -> Marginals:
    """Exact where it can be, else running for discrete percepts, else of the batch."""
    if knows_signals(task):
        return ExactMarginals()
    return RunningMarginals() if isinstance(percept_space, Discrete) else BatchMarginals()
