"""The marginals p(x) and p(a) under the current channels.

What differs between rules is only how p(x) comes about, for which there are three ways here;
p(a) = Σ_x p(x) p(a|x) follows from it and the action channel. Where actions look at the signal
again, p(a|x) is a marginal too, the mean of p(a|x,ξ) over the signals of x, and comes about in the
same way as p(x).
"""

import math
from abc import ABC, abstractmethod
from typing import Any

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor, nn
from torch.distributions import Distribution

from bra.channels import Channel
from bra.channels.distributions import Categorical, mixture, probabilities
from bra.checkpoints.recipes import Rebuildable
from bra.checks.settings import check_real
from bra.tasks import FiniteStateTask, Task, knows_signals

FRESH = 512
"""Percepts that p(a) is averaged over where they cannot be enumerated."""


class Marginals(Rebuildable, nn.Module, ABC):
    """A way to p(x)."""

    def check(self, task: Task, percept_space: Space[Any]) -> None:
        """Raises ValueError if this way does not lead to p(x) for such a task and percepts."""

    def check_looks(self, task: Task, percept_space: Space[Any]) -> None:
        """The same for p(a|x), where actions look at the signal again."""

    def signals(self, task: Task, observation: Tensor) -> tuple[Tensor, Tensor]:
        """What p(a|x) is a mean over: signals, (C, …), and their weights, (C,).

        Args:
            task: What the agent does.
            observation: ξ of the current batch, (B, …).
        """
        count = len(observation)
        return observation, torch.full((count,), 1 / count, device=observation.device)

    def shared_action(self, log_joint: Tensor, second_look: Distribution) -> Distribution:
        """p(a|x) = Σ_ξ p(ξ|x) p(a|x,ξ), batch shape (X,).

        Args:
            log_joint: log w(ξ) p(x|ξ) of `signals`, (C, X).
            second_look: p(a|x,ξ), batch shape (X, C).
        """
        return mean_action(log_joint, second_look)

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

    def signals(self, task: Task, observation: Tensor) -> tuple[Tensor, Tensor]:
        """All there are, and p(ω)."""
        assert isinstance(task, FiniteStateTask)  # check() saw to it
        prior = task.prior.to(observation.device, torch.get_default_dtype())
        return task.states().observation.to(observation.device), prior

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

    p(a|x) is kept likewise, a signal weighing p(x|ξ) in it. It is low in I(ξ;A|X), for the same
    reason, by some w (1 − ½/(1 + d)) nats for each percept and action but one that is in use.

    Args:
        decay: d, at least 0 and less than 1.

    Raises:
        ValueError: If `decay` is outside.
    """

    average: Tensor
    shared: Tensor
    shared_log_weight: Tensor

    def __init__(self, decay: float = 0.98) -> None:
        super().__init__()
        expected = "at least 0 and less than 1"
        check_real(decay, "decay", expected, lambda decay: 0 <= decay < 1)
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

    def check_looks(self, task: Task, percept_space: Space[Any]) -> None:
        """Asks for discrete actions too."""
        if not isinstance(task.action_space, Discrete):
            raise ValueError(
                f"RunningMarginals need Discrete actions that look again, got {task.action_space}; "
                "use BatchMarginals, or ExactMarginals where the states are known"
            )
        percepts = len(self.average)
        self.register_buffer("shared", torch.zeros(percepts, int(task.action_space.n)))
        self.register_buffer("shared_log_weight", torch.full((percepts,), -math.inf))

    def shared_action(self, log_joint: Tensor, second_look: Distribution) -> Distribution:
        """p(a|x), after this batch has been averaged in."""
        rows = probabilities(second_look).detach()
        average_in(self.shared, self.shared_log_weight, log_joint.detach(), rows, self.decay)
        return Categorical(self.shared)

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


def default_marginals(task: Task, percept_space: Space[Any], looks: bool = False) -> Marginals:
    """Exact where it can be, else running for what is discrete, else of the batch."""
    if knows_signals(task):
        return ExactMarginals()
    averaged = [percept_space, task.action_space] if looks else [percept_space]
    discrete = all(isinstance(space, Discrete) for space in averaged)
    return RunningMarginals() if discrete else BatchMarginals()


def posterior(log_joint: Tensor, log_marginal: Tensor) -> Tensor:
    """p(ω|x) = p(ω,x)/p(x), (…, B, X), from logarithms; 0 for percepts that no state reaches."""
    lowest = torch.finfo(log_marginal.dtype).min  # −∞ less this is −∞ still
    return (log_joint - log_marginal.clamp(min=lowest).unsqueeze(-2)).exp()


def mean_action(log_joint: Tensor, second_look: Distribution) -> Distribution:
    """p(a|x) = Σ_ξ p(ξ|x) p(a|x,ξ), batch shape (X,); see `Marginals.shared_action`."""
    return mixture(posterior(log_joint, log_joint.logsumexp(0)).mT, second_look)


def average_in(
    mean: Tensor, log_weight: Tensor, log_joint: Tensor, values: Tensor, decay: float
) -> None:
    """Takes a batch into E[v|x], in which signal i of k updates ago weighs decayᵏ w(ξ_i) p(x|ξ_i).

    Args:
        mean: E[v|x] so far, (X, Y); changed in place.
        log_weight: Logarithm of its weight, (X,), −inf before the first batch; changed in place.
        log_joint: log w(ξ_i) p(x|ξ_i), (B, X).
        values: v(ξ_i), (B, Y), or v(x,ξ_i), (X, B, Y).
        decay: At least 0 and less than 1.
    """
    log_batch = log_joint.logsumexp(0)
    log_new = log_batch + math.log(1 - decay)
    log_old = log_weight + (math.log(decay) if decay else -math.inf)
    log_sum = torch.logaddexp(log_new, log_old)
    log_weight.copy_(log_sum)
    batch = (posterior(log_joint, log_batch).mT.unsqueeze(-2) @ values).squeeze(-2)
    step = torch.where(log_sum.isneginf(), 0.0, (log_new - log_sum).exp()).unsqueeze(-1)
    mean.add_(step * (batch - mean))  # vmap knows no lerp_
