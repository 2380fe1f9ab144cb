"""What a critic is: an estimate of U(ω, a) from the sensor's signal, for all actions."""

from abc import ABC, abstractmethod

import torch
from gymnasium.spaces import Discrete
from torch import Tensor, nn

from bra.checkpoints.recipes import Rebuildable
from bra.randomness.draws import UniformNumbers
from bra.tasks import Task

ERROR_DECAY = 0.99


class Critic(Rebuildable, nn.Module, ABC):
    """Û(ξ, a) ≈ E[U(ω, a)|ξ], learnt from triplets (ξ, a, U) and from nothing else.

    What it has learnt, and what it learns by, are buffers and so belong to the checkpoint. No
    gradient flows through a critic.
    """

    squared_error: Tensor
    error_weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("squared_error", torch.zeros(()))
        self.register_buffer("error_weight", torch.zeros(()))

    def check(self, task: Task) -> None:
        """Makes room for a task's signals and actions.

        Raises:
            ValueError: If this critic cannot value them.
            TypeError: If it is made for spaces of another kind.
        """
        if not isinstance(task.action_space, Discrete):
            raise ValueError(
                f"{type(self).__name__} values Discrete actions, got {task.action_space}; "
                "use ScoreFunction"
            )
        if task.action_space.n < 2:
            raise ValueError(
                f"{type(self).__name__} values actions to choose from, and {type(task).__name__} "
                "has one only; give it another, or leave the critic out"
            )
        try:
            self.make_room(task, int(task.action_space.n))
        except (AttributeError, LookupError, TypeError) as error:
            raise TypeError(
                f"critic: {type(self).__name__} has no room for signals {task.observation_space} "
                f"and {task.action_space.n} actions of {type(task).__name__}: {error}; a critic is "
                "given signals and no percepts"
            ) from error

    @abstractmethod
    def make_room(self, task: Task, actions: int) -> None:
        """Creates what depends on the task's signals and number of actions."""

    @abstractmethod
    def forward(self, observation: Tensor) -> Tensor:
        """Û(ξ, a) of all actions, (B, A), float64: utilities may be far from 0."""

    @abstractmethod
    def learn(
        self, observation: Tensor, action: Tensor, utility: Tensor, uniform: UniformNumbers
    ) -> None:
        """Learns from the encounters of one update.

        Args:
            observation: ξ, (B, …).
            action: a, (B,).
            utility: U(ω, a), (B,), float64.
            uniform: Where random numbers come from; critics that use no others can be trained as
                a `bra.Population` in one go.
        """

    def recall(self, observation: Tensor, uniform: UniformNumbers) -> Tensor:
        """Signals to fit the channels on: those of the update, unless others are remembered."""
        return observation

    def take(
        self,
        observation: Tensor,
        action: Tensor,
        utility: Tensor,
        uniform: UniformNumbers = torch.rand,
    ) -> None:
        """Notes by how much encounters surprise, and learns from them; arguments as `learn`."""
        valued = self(observation).gather(-1, action.unsqueeze(-1)).squeeze(-1)
        error = (valued - utility).square().mean().to(self.squared_error)
        self.squared_error.mul_(ERROR_DECAY).add_(error, alpha=1 - ERROR_DECAY)
        self.error_weight.mul_(ERROR_DECAY).add_(1 - ERROR_DECAY)
        self.learn(observation, action, utility, uniform)

    @property
    def rmse(self) -> float:
        """Root mean square of U − Û(ξ, a) before learning, over the last hundred updates or so."""
        weight = self.error_weight.clamp_min(1 - ERROR_DECAY)
        return (self.squared_error / weight).sqrt().item()
