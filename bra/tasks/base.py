"""What a task is: a world to draw from, and a utility."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from gymnasium.spaces import Box, Space
from torch import Generator, Tensor

from bra.checkpoints.recipes import Rebuildable
from bra.checks.words import amount
from bra.randomness.draws import Streams


class World(NamedTuple):
    """A batch of world-states and what the sensor says of them.

    Attributes:
        state: ω, (batch,) indices for finite tasks, (batch, …) otherwise.
        observation: ξ, (batch,) for `Discrete` observations, (batch, *shape) for a `Box`.
    """

    state: Tensor
    observation: Tensor


class Block(NamedTuple):
    """Worlds of consecutive updates.

    Attributes:
        world: Stacked, (n, B, …), or (n, R, B, …) where each agent has its own.
        first: Number of the first update.
        updates: n.
    """

    world: World
    first: int
    updates: int

    def at(self, index: int) -> World:
        """The worlds of one update."""
        return World(*(part[index] for part in self.world))


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

    def __repr__(self) -> str:
        """What it was made of, and between which spaces it lies."""
        spaces = (getattr(self, name, "?") for name in ("observation_space", "action_space"))
        return "{}: ξ {}, a {}".format(super().__repr__(), *spaces)

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
            WorldError: If `sample` returns something other than a world of `count` states, or
                signals that are none of their space.
        """
        draws = (self.sample(count, generator) for generator in streams.generators(update))
        worlds = [check_world(self, world, count) for world in draws]
        return World(*(torch.stack(parts) for parts in zip(*worlds, strict=True)))

    def sample_updates(self, count: int, streams: Streams, updates: range) -> World:
        """The same for several updates, batch shape (n, R, count): one after the other."""
        worlds = [self.sample_streams(count, streams, update) for update in updates]
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


def check_world(task: Task, world: Any, count: int) -> World:
    """Makes sure that `task.sample` has returned what it promises.

    Args:
        task: What has drawn.
        world: What it has drawn.
        count: How many world-states were asked for.

    Raises:
        WorldError: If it is no world of tensors, there are more or fewer states or signals than
            were asked for, or signals are of another shape than their space says, or not finite.
    """
    name, space = f"{type(task).__name__}.sample returned", task.observation_space
    if not isinstance(world, World):
        raise WorldError(f"{name} {type(world).__name__}; expected bra.World(state, observation)")
    for part, values in zip(World._fields, world, strict=True):
        if not isinstance(values, Tensor):
            raise WorldError(f"{name} {part} as {type(values).__name__}; expected a tensor")
        if values.shape[:1] != (count,):
            raise WorldError(
                f"{name} {part} of shape {tuple(values.shape)}; of "
                f"{amount(count, 'world')} it must begin with {count}"
            )
    signals = world.observation
    if signals.shape[1:] != (space.shape or ()):
        shape = tuple(signals.shape[1:])
        raise WorldError(f"{name} signals of shape {shape}; {space} asks for {space.shape}")
    if signals.is_floating_point() and not signals.isfinite().all():
        raise WorldError(f"{name} signals that are not finite")
    return world


def check_utility(task: Task) -> None:
    """Asks a task for the utility of two encounters, and makes sure that it gives numbers.

    Raises:
        WorldError: If it returns no tensor of one number for each encounter, or NaN.
    """
    world = check_world(task, task.sample(2, Generator().manual_seed(0)), 2)
    space, name = task.action_space, f"{type(task).__name__}.utility returned"
    action = torch.zeros(2, *(space.shape or ()), dtype=None if space.shape else torch.long)
    if isinstance(space, Box):
        action = action.clamp(torch.as_tensor(space.low), torch.as_tensor(space.high))
    utility = task.utility(world.state, action)
    if not isinstance(utility, Tensor):
        raise WorldError(f"{name} {type(utility).__name__}; expected a tensor")
    if utility.shape != (2,):
        shape = tuple(utility.shape)
        raise WorldError(f"{name} shape {shape} for 2 states and 2 actions; expected (2,)")
    if utility.isnan().any():
        raise WorldError(f"{name} NaN for action {action[0].tolist()}")


def from_best(utilities: Tensor) -> tuple[Tensor, Tensor]:
    """Utilities U(ω, ·), (…, A), less the best one of each state, and the best ones, (…), float64.

    What depends on the state alone moves no channel, and would drown differences in rounding.
    """
    utilities = utilities.double()
    best = utilities.amax(-1)
    return (utilities - best.unsqueeze(-1)).to(torch.get_default_dtype()), best
