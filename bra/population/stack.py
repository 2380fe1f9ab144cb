"""Agents of the same shape as one module whose tensors have a leading dimension."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import vmap

from bra.agent.agent import Agent


class Stack:
    """R agents of the same shape: each parameter and buffer a tensor (R, …) under its own name.

    Buffers that do not belong to a state dict and are equal in all agents stay as they are.

    Args:
        agents: R ≥ 1 agents. The first one's modules become those of the stack.

    Attributes:
        modules: Called as they are they see the stacks; `map` and `modules.call` show them the
            state of single agents.
        size: R.
    """

    def __init__(self, agents: Sequence[Agent]) -> None:
        members = [agent.modules_of_chain() for agent in agents]
        self.modules = members[0]
        self.size = len(members)
        self._places: list[tuple[str, dict[str, Tensor | None], str]] = []
        # By the first agent's tensor, since some may be tied; kept, lest its id be given away.
        stacks: dict[int, tuple[Tensor, Tensor]] = {}
        for prefix, module in self.modules.named_modules():
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

    @property
    def state(self) -> dict[str, Tensor]:
        """The stacks by name."""
        return {name: place[leaf] for name, place, leaf in self._places}  # type: ignore[misc]  # never None

    def member(self, index: int) -> dict[str, Tensor]:
        """The state of one agent, as views."""
        return {name: stack[index] for name, stack in self.state.items()}

    def map(
        self,
        function: Callable[..., Any],
        in_dims: tuple[int | None, ...],
        chunk: int | None = None,
    ) -> Callable[..., Any]:
        """`function(modules, *args)` of all agents at once, as a function of (`state`, *args).

        Args:
            function: Takes the modules of one agent, and what belongs to it of the arguments.
            in_dims: For each argument, 0 if each agent has its own slice of it, None if they share
                it.
            chunk: Agents at once; None for all.
        """

        def of_one(state: dict[str, Tensor], *args: Any) -> Any:
            return self.modules.call(state, function, *args)

        return vmap(of_one, in_dims=(0, *in_dims), chunk_size=chunk)


def _is_constant(module: nn.Module, leaf: str, tensors: Sequence[Tensor]) -> bool:
    return leaf in module._non_persistent_buffers_set and all(
        torch.equal(tensors[0], tensor) for tensor in tensors
    )
