"""Loss and gradient of many agents in one go, each with its own random numbers."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch._inductor import compile as compile_graph
from torch.func import functionalize
from torch.fx.experimental.proxy_tensor import make_fx

from bra.chain import Chain
from bra.objective import Objective
from bra.population.agents_last import AgentsLast, fill_room, lay_agents_last, room_for
from bra.population.shared_exponentials import share_exponentials
from bra.population.stack import Parts, Stack
from bra.randomness.draws import Uniform
from bra.randomness.generators import counted
from bra.randomness.keys import split, stream_keys, update_key
from bra.tasks import Task, World

CPU_OPTIONS: dict[str, str | int | bool | Callable[..., Any]] = {
    "cpp_wrapper": True,  # what calls the kernels is compiled too
    "cpp.use_decompose_tanh": True,  # by exp, to the same absolute precision
}

Terms = dict[str, Tensor]
Gradients = tuple[Tensor | None, ...]
Step = Callable[..., tuple[Tensor, Gradients, Terms]]


@dataclass(frozen=True)
class Descent:
    """What an update of a stack descends.

    Attributes:
        loss: The sum of the agents' losses, whose gradient is that of each in its own slice.
        gradients: Of the loss, by name of the parameter and turned as `Stack.turned` does; None
            where they are to be back-propagated.
        terms: The terms of J as the update saw them, (R,) each.
    """

    loss: Tensor
    gradients: dict[str, Tensor | None] | None
    terms: Objective[Tensor]


class StackedLoss:
    """The rule's loss of every agent of a stack, as a function of worlds, prices and seeds.

    All agents are one batch (`torch.func.vmap`) if their rule draws nothing, or only by
    `Chain.draw` from outcomes that can be enumerated. Loss and gradient of the batch are then one
    step, which can be compiled: what one agent does is recorded, on copies, and done by all in
    every update, with the agents in the last dimension (`bra.population.agents_last`). Agents whose
    channels, rule or task draw from torch's default generators, which cannot tell one agent from
    another, take turns; the first update finds out, on a copy.

    Args:
        stack: The agents.
        task: Theirs.
        sees_worlds: Whether each agent has worlds of its own, (R, B, …), or none that matter.
        compiled: Whether to compile the batch.
    """

    def __init__(self, stack: Stack, task: Task, sees_worlds: bool, compiled: bool) -> None:
        self.stack, self.task, self.sees_worlds = stack, task, sees_worlds
        self.compiled = compiled
        world_dim = 0 if sees_worlds else None
        self._batch = stack.map(self._of_one_of_batch, (0, 0, world_dim, world_dim, None, 0))
        self._steps: dict[tuple[Any, ...], Step | None] = {}
        self._count = torch.zeros((), dtype=torch.long)

    def __call__(
        self,
        world: World,
        beta_perception: Tensor,
        beta_action: Tensor,
        seeds: tuple[int, ...],
        update: int,
        stream: str,
    ) -> Descent:
        """Loss and gradient of one update.

        Args:
            world: Worlds (R, B, …), or (B, …) where the rule sees none.
            beta_perception: β₁ of the update, (R,).
            beta_action: β₂ of the update, (R,).
            seeds: Of the agents' random numbers.
            update: Number of the update.
            stream: Name of the streams that it draws from.
        """
        if self.compiled and self.sees_worlds:
            world = World(*map(lay_agents_last, world))
        state, memory = self.stack.state, self.stack.memory()
        trained = [name for name, tensor in state.items() if tensor.requires_grad]
        prices = (beta_perception, beta_action)
        # What a step is made for: of all that it is given shapes, types and devices.
        key = (
            self.stack.parts.training,
            torch.is_autocast_enabled(beta_perception.device.type),
            *trained,
            *((part.shape, part.dtype, part.device) for part in world),
            *((own.dtype, own.device) for own in (*memory.values(), *prices)),
        )
        if key not in self._steps:
            self._steps[key] = self._make_step(trained, world, prices)
        step = self._steps[key]
        if step is None:
            losses, terms = self._in_turn(world, prices, seeds, update, stream)
            terms = {name: term.detach() for name, term in terms.items()}
            return Descent(losses.sum(), None, Objective(**terms))
        device = beta_perception.device
        keys = stream_keys(seeds, stream, device)
        if self._count.device != device:
            self._count = self._count.to(device)
        loss, found, terms = step(
            *memory.values(), *prices, *world, self._count.fill_(update), keys
        )
        return Descent(loss, dict(zip(trained, found, strict=True)), Objective(**terms))

    def _make_step(
        self, trained: Sequence[str], world: World, prices: tuple[Tensor, Tensor]
    ) -> Step | None:
        """The sum of losses, its gradient and the terms of J; None if agents have to take turns.

        A function of (*state, β₁, β₂, ω, ξ, update, keys), which are tensors all.
        """
        if self._draws_by_default(world, prices):
            return None
        if self.compiled:
            return self._compile(trained, world, prices)
        of_all = self._with_gradient(trained, self._batch)

        def step(*inputs: Tensor) -> tuple[Tensor, Gradients, Terms]:
            loss, found, terms = of_all(*inputs)
            # Fused optimizers go through memory without asking for strides.
            return loss, tuple(None if g is None else g.contiguous() for g in found), terms

        return step

    def _with_gradient(self, trained: Sequence[str], function: Callable[..., Any]) -> Step:
        """Sum of losses, its gradient, and terms, as a function of (*state, *args).

        Args:
            trained: Names of the parameters.
            function: Losses and terms as a function of (state, *args).
        """
        names = [*self.stack.state]

        def step(*inputs: Tensor) -> tuple[Tensor, Gradients, Terms]:
            state = dict(zip(names, inputs[: len(names)], strict=True))
            with torch.enable_grad():
                parameters = [state[name].detach().requires_grad_() for name in trained]
                state |= zip(trained, parameters, strict=True)
                losses, terms = function(state, *inputs[len(names) :])
                loss = losses.sum()
                found = torch.autograd.grad(loss, parameters, allow_unused=True)
            return loss.detach(), found, {n: term.detach() for n, term in terms.items()}

        return step

    def _compile(self, trained: Sequence[str], world: World, prices: tuple[Tensor, Tensor]) -> Step:
        """Records what one agent does, and compiles it for all with the agents last."""
        device, size = prices[0].device, self.stack.size
        count = torch.zeros((), dtype=torch.long, device=device)
        keys = torch.zeros(size, dtype=torch.long, device=device)
        copies = [tensor.clone() for tensor in self.stack.memory().values()]
        rest = [*prices, *world, count, keys]
        own = [*[True] * (len(copies) + 2), *[self.sees_worlds] * 2, False, True]

        def of_all(*inputs: Tensor) -> Iterator[Tensor]:
            """Of inputs (R, …), or shared by all agents."""
            for tensor, is_own in zip(inputs, own[len(copies) :], strict=True):
                yield fill_room(tensor.movedim(0, -1)) if is_own else tensor

        def of_one(state: dict[str, Tensor], *args: Any) -> Any:
            return self.stack.call(state, self._of_one_of_batch, *args)

        first = [
            tensor[..., 0].clone() if is_own else tensor
            for tensor, is_own in zip([*copies, *of_all(*rest)], own, strict=True)
        ]
        recorded = make_fx(self._with_gradient(trained, of_one))(*first)
        functional = make_fx(functionalize(recorded))(*first)
        share_exponentials(functional)
        agents = AgentsLast(functional, room_for(size))
        names: list[str] = []
        known: list[bool] = []

        def flat(*inputs: Tensor) -> tuple[Tensor, ...]:
            state, rest = inputs[: len(copies)], inputs[len(copies) :]
            losses, found, terms = agents(own, [*state, *of_all(*rest)])
            names[:], known[:] = terms, (gradient is not None for gradient in found)
            gradients = (gradient.contiguous() for gradient in found if gradient is not None)
            return losses[:size].sum(), *(term[:size] for term in terms.values()), *gradients

        graph = make_fx(flat)(*copies, *rest)
        for node in graph.graph.nodes:
            node.meta.clear()  # of values as traced, each of a kind of its own
        options = CPU_OPTIONS if device.type == "cpu" else {}
        # Without the guards of `torch.compile`, whose work `_steps` does, and which cost a tenth.
        compiled = compile_graph(graph, [*copies, *rest], options)

        def step(*inputs: Tensor) -> tuple[Tensor, Gradients, Terms]:
            loss, *rest = compiled(*inputs)
            found = iter(rest[len(names) :])
            gradients = tuple(next(found) if there else None for there in known)
            return loss, gradients, dict(zip(names, rest, strict=False))

        return step

    def _of_one(
        self,
        parts: Parts,
        beta_perception: Tensor,
        beta_action: Tensor,
        state: Tensor,
        observation: Tensor,
        update: int | Tensor,
        uniform: Uniform,
    ) -> tuple[Tensor, Terms]:
        chain = Chain.of(parts, beta_perception, beta_action).at(update, uniform)  # type: ignore[arg-type]  # a tensor serves where it is not asked for control flow
        loss, terms = parts.update_rule.loss(chain, World(state, observation))
        return loss, terms.known()

    def _of_one_of_batch(
        self,
        parts: Parts,
        beta_perception: Tensor,
        beta_action: Tensor,
        state: Tensor,
        observation: Tensor,
        update: Tensor,
        key: Tensor,
    ) -> tuple[Tensor, Terms]:
        """`_of_one` with the number of the update and the key of the agent's stream as tensors."""
        uniform = Uniform(split(key, update))
        return self._of_one(
            parts, beta_perception, beta_action, state, observation, update, uniform
        )

    def _in_turn(
        self,
        world: World,
        prices: tuple[Tensor, Tensor],
        seeds: Sequence[int],
        update: int,
        stream: str,
    ) -> tuple[Tensor, Terms]:
        found = []
        for index, seed in enumerate(seeds):
            own = self._world_of(index, world)
            uniform = Uniform(update_key(seed, stream, update))
            with counted(seed, update, stream, prices[0].device):
                state = self.stack.member(index)
                betas = (price[index] for price in prices)
                found.append(self.stack.call(state, self._of_one, *betas, *own, update, uniform))
        losses, terms = zip(*found, strict=True)
        names = terms[0].keys()
        return torch.stack(losses), {n: torch.stack([term[n] for term in terms]) for n in names}

    @torch.no_grad()
    def _draws_by_default(self, world: World, prices: tuple[Tensor, Tensor]) -> bool:
        """Whether the first agent's update, on a copy of its state, moves a default generator."""
        device = prices[0].device
        state = {name: tensor.clone() for name, tensor in self.stack.member(0).items()}
        betas = (price[0] for price in prices)
        with counted(0, 0, "dry run", device):
            before = _generator_states(device)
            own = self._world_of(0, world)
            self.stack.call(state, self._of_one, *betas, *own, 0, Uniform(0))
            after = _generator_states(device)
        return not all(map(torch.equal, before, after))

    def _world_of(self, index: int, world: World) -> tuple[Tensor, ...]:
        return tuple(part[index] for part in world) if self.sees_worlds else tuple(world)


def _generator_states(device: torch.device) -> list[Any]:
    states = [torch.default_generator.get_state()]
    if device.type == "cuda":
        states.append(torch.cuda.get_rng_state(device))
    return states
