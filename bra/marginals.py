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

    def action(
        self, action: Channel, percept_marginal: Distribution, percepts: Tensor
    ) -> Distribution:
        """p(a) = Σ_x p(x) p(a|x), batch shape ().

        Args:
            action: The action channel.
            percept_marginal: p(x).
            percepts: (samples, …) draws from p(x), over which p(a|x) is averaged where percepts
                cannot be enumerated.
        """
        if percept_marginal.has_enumerate_support:
            return mixture(probabilities(percept_marginal), action.forward_all())
        count = len(percepts)
        return mixture(percepts.new_full((count,), 1 / count), action(percepts))


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

    Costs of information come out low by O(1/B), since each p(x|ξ_i) is part of its own marginal.
    """

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
