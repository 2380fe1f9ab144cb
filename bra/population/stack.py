"""Agents of the same shape as one module whose tensors have a leading dimension."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from bra.agent.agent import Agent
from bra.population.agents_last import fill_room


class Parts(nn.Module):
    """What of an agent has a state, as one module."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        self.task = agent.task
        self.perception = agent.perception
        self.action = agent.action
        self.marginals = agent.marginals
        self.update_rule = agent.update_rule

    def forward(self, function: Callable[..., Any], *args: Any) -> Any:
        """Returns `function(self, *args)`, with whatever state this module has for now."""
        return function(self, *args)


class Stack:
    """R agents of the same shape: each parameter and buffer a tensor (R, …) under its own name.

    Buffers that do not belong to a state dict and are equal in all agents stay as they are.

    Args:
        agents: R ≥ 1 agents. The first one's modules become those of the stack.
        agents_last: Whether memory is contiguous along the agents, and not along what each has,
            which is how `bra.population.agents_last` goes through it; with room for a few more.
            Shapes are the same.

    Attributes:
        parts: The modules. Called as they are they see the stacks; `map` and `call` show them the
            state of single agents.
    """

    def __init__(self, agents: Sequence[Agent], agents_last: bool = False) -> None:
        self.agents_last = agents_last
        self._memory: dict[str, Tensor] = {}
        self._turned: dict[str, nn.Parameter] = {}
        members = [Parts(agent) for agent in agents]
        self.parts = members[0]
        self.size = len(members)
        self._places: list[tuple[str, dict[str, Tensor | None], str]] = []
        # By the first agent's tensor, since some may be tied; kept, lest its id be given away.
        stacks: dict[int, tuple[Tensor, Tensor]] = {}
        for prefix, module in self.parts.named_modules():
            twins = [member.get_submodule(prefix) for member in members]
            for leaf in [*module._parameters, *module._buffers]:
                kind = "_parameters" if leaf in module._parameters else "_buffers"
                tensors = [getattr(twin, kind)[leaf] for twin in twins]
                if tensors[0] is None or _is_constant(module, leaf, tensors):
                    continue
                place, key = getattr(module, kind), id(tensors[0])
                if key not in stacks:
                    stack = torch.stack([tensor.detach() for tensor in tensors])
                    if kind == "_parameters":
                        stack = nn.Parameter(stack, tensors[0].requires_grad)
                    stacks[key] = tensors[0], stack
                    self._places.append((f"{prefix}.{leaf}", place, leaf))
                place[leaf] = stacks[key][1]
        self.memory()

    @property
    def state(self) -> dict[str, Tensor]:
        """The stacks by name."""
        return {name: place[leaf] for name, place, leaf in self._places}  # type: ignore[misc]  # never None

    def member(self, index: int) -> dict[str, Tensor]:
        """The state of one agent, as views."""
        return {name: stack[index] for name, stack in self.state.items()}

    def memory(self) -> dict[str, Tensor]:
        """What the stacks are views of, without gradients: (…, R′) if agents are last.

        Stacks that were moved to another device, say, are laid out anew.
        """
        if not self.agents_last:
            return {name: stack.detach() for name, stack in self.state.items()}
        for name, stack in self.state.items():
            memory = self._memory.get(name)
            if memory is None or memory.data_ptr() != stack.data_ptr() or not _alike(memory, stack):
                self._memory[name] = memory = self._turn(stack.detach())
                stack.data = self._of_agents(memory)
        return self._memory

    def _of_agents(self, memory: Tensor) -> Tensor:
        return memory[..., : self.size].movedim(-1, 0)

    def turned(self, stack: nn.Parameter) -> nn.Parameter:
        """What an optimizer is given in place of a stack: itself, or its memory.

        Fused optimizers go through memory without asking for strides.
        """
        if not self.agents_last:
            return stack
        (name,) = (name for name, own in self.state.items() if own is stack)
        turned = nn.Parameter(self.memory()[name], stack.requires_grad)
        self._turned[name] = turned
        return turned

    def turn_gradient(self, gradient: Tensor | None) -> Tensor | None:
        """The gradient (R, …) of a stack, for what an optimizer is given by `turned`."""
        return gradient if gradient is None else self._turn(gradient)

    def _turn(self, tensor: Tensor) -> Tensor:
        return fill_room(tensor.movedim(0, -1)).contiguous() if self.agents_last else tensor

    def _turn_back(self, tensor: Tensor) -> Tensor:
        return self._of_agents(tensor).contiguous() if self.agents_last else tensor

    def set_gradients(self, gradients: Mapping[str, Tensor | None]) -> None:
        """Gives gradients, by name and turned, to what optimizers were given, or else to stacks."""
        for name, stack in self.state.items():
            if name not in gradients:
                continue
            gradient = gradients[name]
            if name in self._turned:
                self._turned[name].grad = gradient
            else:
                stack.grad = gradient if gradient is None else self._turn_back(gradient)

    def turn(self, optimizer_state: dict[str, Any]) -> dict[str, Any]:
        """The state dict of an optimizer of stacks (R, …), for what it is given by `turned`."""
        return _map_state(self._turn, optimizer_state)

    def turn_back(self, optimizer_state: dict[str, Any]) -> dict[str, Any]:
        """The reverse of `turn`."""
        return _map_state(self._turn_back, optimizer_state)

    def map(
        self,
        function: Callable[..., Any],
        in_dims: tuple[int | None, ...],
        chunk: int | None = None,
    ) -> Callable[..., Any]:
        """`function(parts, *args)` of all agents at once, as a function of (`state`, *args).

        Args:
            function: Takes the modules of one agent, and what belongs to it of the arguments.
            in_dims: For each argument, 0 if each agent has its own slice of it, None if they share
                it.
            chunk: Agents at once; None for all.
        """

        def of_one(state: dict[str, Tensor], *args: Any) -> Any:
            return self.call(state, function, *args)

        return vmap(of_one, in_dims=(0, *in_dims), chunk_size=chunk)

    def call(self, state: dict[str, Tensor], function: Callable[..., Any], *args: Any) -> Any:
        """`function(parts, *args)` of the agent in a state."""
        return functional_call(self.parts, state, (function, *args))


def _is_constant(module: nn.Module, leaf: str, tensors: Sequence[Tensor]) -> bool:
    return leaf in module._non_persistent_buffers_set and all(
        torch.equal(tensors[0], tensor) for tensor in tensors
    )


def _alike(one: Tensor, other: Tensor) -> bool:
    """Also of what is empty, and has no place in memory."""
    return one.dtype == other.dtype and one.device == other.device


def _map_state(
    function: Callable[[Tensor], Tensor], optimizer_state: dict[str, Any]
) -> dict[str, Any]:
    """A state dict of an optimizer with all tensors but numbers mapped."""

    def mapped(value: Any) -> Any:
        return function(value) if isinstance(value, Tensor) and value.ndim else value

    kept = {
        index: {name: mapped(value) for name, value in values.items()}
        for index, values in optimizer_state["state"].items()
    }
    return optimizer_state | {"state": kept}
