"""The losses of many agents in one go, each with its own random numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from bra.objective import Objective
from bra.randomness import counted, counted_seed
from bra.stack import Parts, Stack
from bra.tasks import Task, World
from bra.update_rules import Chain

Terms = dict[str, Tensor]


@dataclass(frozen=True)
class Draws:
    """What a rule draws in one update.

    Attributes:
        shapes: Of the blocks of uniform numbers that it asks its chain for, in order.
        others: Whether it draws anything else.
    """

    shapes: tuple[tuple[tuple[int, ...], torch.dtype], ...]
    others: bool


class StackedLoss:
    """The rule's loss of every agent of a stack, as a function of worlds, prices and seeds.

    All agents are one batch (`torch.func.vmap`) if their rule draws nothing, or only by
    `Chain.draw` from outcomes that can be enumerated: then every agent's numbers are drawn
    beforehand, from its own stream. Otherwise the agents take turns.

    Args:
        stack: The agents.
        task: Theirs.
        sees_worlds: Whether each agent has worlds of its own, (R, B, …), or none that matter.
        compiled: Whether to run the batch through `torch.compile`.
    """

    def __init__(self, stack: Stack, task: Task, sees_worlds: bool, compiled: bool) -> None:
        self.stack, self.task, self.sees_worlds = stack, task, sees_worlds
        world_dim = 0 if sees_worlds else None
        batch = stack.map(self._of_one_given, (0, 0, world_dim, world_dim, None, 0))
        self._batch: Callable[..., tuple[Tensor, Terms]] = (
            torch.compile(batch, fullgraph=True) if compiled else batch
        )
        self._draws: dict[tuple[torch.Size, ...], Draws] = {}

    def __call__(
        self,
        world: World,
        beta_perception: Tensor,
        beta_action: Tensor,
        seeds: Sequence[int],
        update: int,
        place: str,
    ) -> tuple[Tensor, Objective[Tensor]]:
        """Losses, (R,), and the terms of J as the update saw them, (R,) each.

        Args:
            world: Worlds (R, B, …), or (B, …) where the rule sees none.
            beta_perception: β₁ of the update, (R,).
            beta_action: β₂ of the update, (R,).
            seeds: Of the agents' random numbers.
            update: Number of the update.
            place: Where it draws.
        """
        device = beta_perception.device
        key = tuple(part.shape for part in world)
        if key not in self._draws:
            self._draws[key] = self._dry_run(world, beta_perception, beta_action)
        draws = self._draws[key]
        if draws.others:
            losses, terms = self._in_turn(world, beta_perception, beta_action, seeds, update, place)
        else:
            numbers = uniform_blocks(draws, [counted_seed(s, update, place) for s in seeds], device)
            losses, terms = self._batch(
                self.stack.state, beta_perception, beta_action, *world, update, numbers
            )
        return losses, Objective(**{name: term.detach() for name, term in terms.items()})

    def _of_one(
        self,
        parts: Parts,
        beta_perception: Tensor,
        beta_action: Tensor,
        state: Tensor,
        observation: Tensor,
        update: int,
        uniform: Callable[..., Tensor],
    ) -> tuple[Tensor, Terms]:
        chain = Chain(
            self.task,
            parts.perception,
            parts.action,
            parts.marginals,
            beta_perception,
            beta_action,
            update,
            uniform,
        )
        loss, terms = parts.update_rule.loss(chain, World(state, observation))
        return loss, {name: term for name, term in vars(terms).items() if term is not None}

    def _of_one_given(
        self,
        parts: Parts,
        beta_perception: Tensor,
        beta_action: Tensor,
        state: Tensor,
        observation: Tensor,
        update: int,
        numbers: tuple[Tensor, ...],
    ) -> tuple[Tensor, Terms]:
        """`_of_one` with random numbers that are drawn."""
        rest = iter(numbers)
        return self._of_one(
            parts,
            beta_perception,
            beta_action,
            state,
            observation,
            update,
            lambda *_, **__: next(rest),
        )

    def _in_turn(
        self,
        world: World,
        beta_perception: Tensor,
        beta_action: Tensor,
        seeds: Sequence[int],
        update: int,
        place: str,
    ) -> tuple[Tensor, Terms]:
        found = []
        for index, seed in enumerate(seeds):
            prices = (beta_perception[index], beta_action[index])
            own = tuple(part[index] for part in world) if self.sees_worlds else tuple(world)
            with counted(seed, update, place, beta_perception.device):
                state = self.stack.member(index)
                found.append(
                    self.stack.call(state, self._of_one, *prices, *own, update, torch.rand)
                )
        losses, terms = zip(*found, strict=True)
        names = terms[0].keys()
        return torch.stack(losses), {n: torch.stack([term[n] for term in terms]) for n in names}

    @torch.no_grad()
    def _dry_run(self, world: World, beta_perception: Tensor, beta_action: Tensor) -> Draws:
        """Runs the first agent's update on a copy of its state, and takes down what it draws."""
        shapes: list[tuple[tuple[int, ...], torch.dtype]] = []

        def uniform(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
            shapes.append((tuple(shape), dtype))
            return torch.full(shape, 0.5, dtype=dtype, device=device)

        device = beta_perception.device
        own = tuple(part[0] for part in world) if self.sees_worlds else tuple(world)
        state = {name: tensor.clone() for name, tensor in self.stack.member(0).items()}
        prices = (beta_perception[0], beta_action[0])
        with counted(0, 0, "dry run", device):
            before = _generator_states(device)
            self.stack.call(state, self._of_one, *prices, *own, 0, uniform)
            after = _generator_states(device)
        others = not all(map(torch.equal, before, after))
        return Draws(tuple(shapes), others)


def uniform_blocks(draws: Draws, seeds: Sequence[int], device: torch.device) -> tuple[Tensor, ...]:
    """Uniform numbers of every agent, a tensor (R, *shape) per block.

    They are those that `torch.rand` would draw with its generator seeded by the agent's seed.
    """
    if not draws.shapes:
        return ()
    generator = torch.Generator(device)
    rows = []
    for seed in seeds:
        generator.manual_seed(seed)
        rows.append(
            [
                torch.rand(shape, dtype=dtype, device=device, generator=generator)
                for shape, dtype in draws.shapes
            ]
        )
    return tuple(torch.stack(block) for block in zip(*rows, strict=True))


def _generator_states(device: torch.device) -> list[Any]:
    states = [torch.default_generator.get_state()]
    if device.type == "cuda":
        states.append(torch.cuda.get_rng_state(device))
    return states
