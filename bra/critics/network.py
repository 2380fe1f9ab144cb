"""A network that values all actions."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from gymnasium.spaces import Space
from torch import Tensor, nn
from torch.func import functional_call, grad

from bra.channels.mlp import xavier_linear
from bra.channels.spaces import feature_count, features
from bra.checks import check_count
from bra.critics.base import Critic
from bra.critics.replay import Replay
from bra.randomness.draws import UniformNumbers
from bra.tasks import Task

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class NetworkCritic(Critic):
    """Û(ξ, ·) from a fully connected network, fitted to remembered triplets by squared error.

    Every update remembers its encounters and makes `steps` steps of Adam (Kingma & Ba, ICLR 2015)
    on `batch_size` remembered triplets each; the channels, too, are fitted on `batch_size`
    remembered signals. Actions that have become rare are so not forgotten, and one encounter per
    update is enough. The network's outputs count from `start`, in units of how far utilities were
    from it at most, so that it learns alike whatever utilities are measured in.

    Args:
        hidden: Sizes of the hidden layers, with rectified linear units.
        start: Where Û starts; half of the best utility serves well. None is what the first
            encounters bring.
        memory: Triplets remembered.
        batch_size: Triplets per step.
        steps: Steps per update.
        lr: Learning rate.

    Raises:
        ValueError: If a number is not positive, or `start` not finite.
    """

    space: Space[Any]
    network: nn.Sequential
    origin: Tensor
    reach: Tensor
    mean: Tensor
    square: Tensor
    made: Tensor

    def __init__(
        self,
        hidden: Sequence[int] = (64,),
        start: float | None = None,
        memory: int = 4096,
        batch_size: int = 32,
        steps: int = 1,
        lr: float = 0.003,
    ) -> None:
        super().__init__()
        if any(size < 1 for size in hidden):
            raise ValueError(f"hidden sizes must be at least 1, got {list(hidden)}")
        if start is not None and not math.isfinite(start):
            raise ValueError(f"start must be finite, got {start}")
        if not 0 < lr < math.inf:
            raise ValueError(f"lr must be positive and finite, got {lr}")
        self.hidden, self.start, self.lr = hidden, start, lr
        self.batch_size = check_count(batch_size, "batch_size")
        self.steps = check_count(steps, "steps")
        self.replay = Replay(memory)
        for name in ("mean", "square", "made"):
            self.register_buffer(name, torch.zeros(0))
        self.register_buffer("origin", torch.tensor(start or 0.0, dtype=torch.double))
        self.register_buffer("reach", torch.zeros((), dtype=torch.double))

    def make_room(self, task: Task, actions: int) -> None:
        """The network, the moments of its gradient, and the memory."""
        self.space = task.observation_space
        sizes = [feature_count(self.space), *self.hidden, actions]
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(sizes):
            layers += [xavier_linear(inputs, outputs, bias=True), nn.ReLU()]
        self.network = nn.Sequential(*layers[:-1]).requires_grad_(False)
        size = sum(weight.numel() for weight in self.network.parameters())
        self.mean, self.square, self.made = torch.zeros(size), torch.zeros(size), torch.zeros(())
        self.replay.make_room(self.space)

    def forward(self, observation: Tensor) -> Tensor:
        """Û(ξ, a) of all actions, (B, A), float64."""
        value = self._value(dict(self.network.named_parameters()), observation)
        return self.origin + self._unit() * value.double()

    def take(
        self,
        observation: Tensor,
        action: Tensor,
        utility: Tensor,
        uniform: UniformNumbers = torch.rand,
    ) -> None:
        """Notes where utilities are and how far they reach, and goes on; see `Critic.take`."""
        if self.start is None:
            first = self.replay.written == 0
            self.origin.copy_(torch.where(first, utility.mean(), self.origin))
        farthest = (utility - self.origin).abs().amax()
        self.reach.copy_(torch.maximum(self.reach, farthest))
        super().take(observation, action, utility, uniform)

    def learn(
        self, observation: Tensor, action: Tensor, utility: Tensor, uniform: UniformNumbers
    ) -> None:
        """Remembers the encounters and makes the steps."""
        self.replay.add(observation, action, utility - self.origin)
        for _ in range(self.steps):
            self._step(*self.replay.draw(self.batch_size, uniform))

    def recall(self, observation: Tensor, uniform: UniformNumbers) -> Tensor:
        """Remembered signals."""
        return self.replay.draw(self.batch_size, uniform)[0]

    def _unit(self) -> Tensor:
        """What the network's outputs are multiples of, ()."""
        return torch.where(self.reach > 0, self.reach, 1.0)

    def _value(self, weights: Mapping[str, Tensor], observation: Tensor) -> Tensor:
        inputs = features(self.space, observation, torch.get_default_dtype())
        value: Tensor = functional_call(self.network, dict(weights), (inputs,))
        return value

    def _loss(
        self, weights: Mapping[str, Tensor], observation: Tensor, action: Tensor, utility: Tensor
    ) -> Tensor:
        value = self._value(weights, observation).gather(-1, action.unsqueeze(-1)).squeeze(-1)
        return (value - utility / self._unit()).to(value).square().mean()

    def _step(self, observation: Tensor, action: Tensor, utility: Tensor) -> None:
        """One step of Adam, on buffers, so that it is part of the checkpoint and can be vmapped."""
        weights = dict(self.network.named_parameters())
        gradient = grad(self._loss)(weights, observation, action, utility)
        flat = torch.cat([gradient[name].flatten() for name in weights])
        self.made += 1
        self.mean.mul_(BETA_1).add_(flat, alpha=1 - BETA_1)
        self.square.mul_(BETA_2).add_(flat.square(), alpha=1 - BETA_2)
        scale = (self.square / (1 - BETA_2**self.made)).sqrt() + EPSILON
        step = self.lr * self.mean / (1 - BETA_1**self.made) / scale
        sizes = [weight.numel() for weight in weights.values()]
        for weight, part in zip(weights.values(), torch.split(step, sizes), strict=True):
            weight.sub_(part.view_as(weight))
