"""The loss of many agents in one go, each with its own random numbers."""

from collections.abc import Sequence

import torch
from torch import Tensor

from bra.blocks.modules import Modules, Terms
from bra.population.stack import Stack
from bra.randomness.draws import Uniform
from bra.randomness.generators import counted, drawing_by_default
from bra.randomness.keys import stream_keys, update_key
from bra.tasks import World


class StackedLoss:
    """The rule's loss of every agent of a stack, as a function of worlds, prices and seeds.

    All agents are one batch (`torch.func.vmap`) if their rule draws nothing, or only by
    `Chain.draw` from outcomes that can be enumerated. Agents whose channels, rule or task draw from
    torch's default generators, which cannot tell one agent from another, take turns; the first
    update finds out, on a copy.

    Args:
        stack: The agents.
        sees_worlds: Whether each agent has worlds of its own, (R, B, …), or none that matter.
    """

    def __init__(self, stack: Stack, sees_worlds: bool) -> None:
        self.stack, self.sees_worlds = stack, sees_worlds
        world_dim = 0 if sees_worlds else None
        self._of_all = stack.map(Modules.keyed_loss, (0, world_dim, None, 0))
        self._take_turns: bool | None = None

    def __call__(
        self,
        world: World,
        prices: tuple[Tensor, ...],
        seeds: tuple[int, ...],
        update: int,
        stream: str,
    ) -> tuple[Tensor, Terms]:
        """Sum of the losses, whose gradient is that of each in its own slice; and terms of J, (R,).

        Args:
            world: Worlds (R, B, …), or (B, …) where the rule sees none.
            prices: β₁ and β₂ of the update, (R,) each.
            seeds: Of the agents' random numbers.
            update: Number of the update.
            stream: Name of the streams that it draws from.
        """
        if self._take_turns is None:
            self._take_turns = self._draws_by_default(world, prices)
        if self._take_turns:
            losses, terms = self._in_turn(world, prices, seeds, update, stream)
        else:
            device = prices[0].device
            keys = stream_keys(seeds, stream, device)
            count = torch.tensor(update, device=device)
            losses, terms = self._of_all(self.stack.state, prices, world, count, keys)
        return losses.sum(), {name: term.detach() for name, term in terms.items()}

    def _in_turn(
        self,
        world: World,
        prices: tuple[Tensor, ...],
        seeds: Sequence[int],
        update: int,
        stream: str,
    ) -> tuple[Tensor, Terms]:
        found = []
        for index, seed in enumerate(seeds):
            uniform = Uniform(update_key(seed, stream, update))
            with counted(seed, update, stream, prices[0].device):
                found.append(
                    self.stack.modules.call(
                        self.stack.member(index),
                        Modules.loss,
                        tuple(price[index] for price in prices),
                        self._world_of(index, world),
                        update,
                        uniform,
                    )
                )
        losses, terms = zip(*found, strict=True)
        return torch.stack(losses), {n: torch.stack([term[n] for term in terms]) for n in terms[0]}

    @torch.no_grad()
    def _draws_by_default(self, world: World, prices: tuple[Tensor, ...]) -> bool:
        """Whether the first agent's update, on a copy of its state, moves a default generator."""
        state = {name: tensor.clone() for name, tensor in self.stack.member(0).items()}
        first = (tuple(price[0] for price in prices), self._world_of(0, world), 0, Uniform(0))
        with drawing_by_default(prices[0].device) as drawn:
            self.stack.modules.call(state, Modules.loss, *first)
        return drawn()

    def _world_of(self, index: int, world: World) -> World:
        return World(*(part[index] for part in world)) if self.sees_worlds else world
