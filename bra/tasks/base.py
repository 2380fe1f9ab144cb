"""What a task is: a world to draw from, and a utility."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from gymnasium.spaces import Space
from torch import Generator, Tensor

from bra.checkpoints.recipes import Rebuildable
from bra.randomness.draws import Streams


class World(NamedTuple):
    """A batch of world-states and what the sensor says of them.

    Attributes:
        state: ω, (batch,) indices for finite tasks, (batch, …) otherwise.
        observation: ξ, (batch,) for `Discrete` observations, (batch, *shape) for a `Box`.
    """

    state: Tensor
    observation: Tensor


class Rollout(NamedTuple):
    """A batch of encounters: world-state, sensor signal, percept, action and utility.

    Attributes:
        state: ω, (*batch, …).
        observation: ξ, (*batch, …).
        percept: x, (*batch, …).
        action: a, (*batch, …).
        utility: U(ω, a), (*batch,).
    """

    state: Tensor
    observation: Tensor
    percept: Tensor
    action: Tensor
    utility: Tensor


class WorldError(RuntimeError):
    """The world of a task, a simulator say, fails for a reason that one line can tell."""


class Task(Rebuildable, ABC):
    """A one-step decision: ω ~ p(ω), a sensor signal ξ of ω, an action a, a utility U(ω, a).

    Attributes:
        observation_space: Where ξ lives, `Discrete` or `Box`.
        action_space: Where a lives, `Discrete` or `Box`.
    """

    observation_space: Space[Any]
    action_space: Space[Any]

    def __init_subclass__(cls, **keywords: Any) -> None:
        """A class that draws worlds in its own way draws those of streams in this way too."""
        super().__init_subclass__(**keywords)
        if {"sample", "observe"} & vars(cls).keys() and "sample_streams" not in vars(cls):
            cls.sample_streams = Task.sample_streams  # type: ignore[method-assign]

    @abstractmethod
    def sample(self, count: int, generator: Generator) -> World:
        """Draws `count` world-states and their sensor signals, with random numbers of `generator`.

        Returns:
            A world on the CPU, batch shape (count,).
        """

    def sample_streams(self, count: int, streams: Streams, update: int) -> World:
        """Draws what belongs to `update` of each of R streams: by `sample`, one after the other.

        A task that draws from the streams' own numbers can do so for all of them in one go.

        Returns:
            A world on the CPU, batch shape (R, count).

        Raises:
            TypeError: If `sample` returns something other than a world.
        """
        worlds = [self.sample(count, generator) for generator in streams.generators(update)]
        for world in worlds:
            if not isinstance(world, World):
                raise TypeError(
                    f"{type(self).__name__}.sample returned {type(world).__name__}; "
                    "expected bra.World(state, observation)"
                )
        return World(*(torch.stack(parts) for parts in zip(*worlds, strict=True)))

    @abstractmethod
    def utility(self, state: Tensor, action: Tensor) -> Tensor:
        """U(ω, a), broadcast over the batch shapes of `state` and `action`.

        In float64 if utilities differ by little of what they are: rules look at differences.
        """

    def grid(self, points: int) -> tuple[Tensor, Tensor] | None:
        """A table that stands for continuous states or actions, to solve for a reference optimum.

        None, the default, gives no such table. With a noisy sensor its rows are signals.

        Args:
            points: Along each dimension of what is continuous.

        Returns:
            U(ω, a), (W, A), and p(ω), (W,), of the points; float64.
        """
        return None


def from_best(utilities: Tensor) -> tuple[Tensor, Tensor]:
    """Utilities U(ω, ·), (…, A), less the best one of each state, and the best ones, (…), float64.

    What depends on the state alone moves no channel, and would drown differences in rounding.
    """
    utilities = utilities.double()
    best = utilities.amax(-1)
    return (utilities - best.unsqueeze(-1)).to(torch.get_default_dtype()), best


def utility_table(task: Task, states: Tensor, actions: Tensor) -> Tensor:
    """U(ω, a) of all pairs, asked of the task.

    Args:
        task: What gives U(ω, a).
        states: ω, (W, …).
        actions: a, (A, …).

    Returns:
        (W, A), of whatever type the task gives.
    """
    pairs = task.utility(
        states.repeat_interleave(len(actions), 0),
        actions.repeat(len(states), *[1] * (actions.ndim - 1)),
    )
    return pairs.reshape(len(states), len(actions))
