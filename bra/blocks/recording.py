"""One update of one agent, recorded as a graph without side effects."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch._guards import TracingContext, tracing
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.func import functionalize
from torch.fx import GraphModule, Node
from torch.fx.experimental.proxy_tensor import make_fx
from torch.optim import Optimizer

from bra.blocks.modules import Modules, Terms
from bra.blocks.optimizers import Slots, step
from bra.blocks.traces import Untraceable, nothing_else_changes
from bra.tasks import World

aten = torch.ops.aten

Clip = Callable[[Sequence[Tensor]], None]
"""Clips the gradients of one channel in place."""


@dataclass(frozen=True)
class Channeled:
    """How the parameters of one channel are moved.

    Attributes:
        optimizer: Gives the settings of the steps.
        names: Of the parameters, in the optimizer's order.
        slots: What it keeps of each.
    """

    optimizer: Optimizer
    names: tuple[str, ...]
    slots: tuple[Slots, ...]


@dataclass(frozen=True)
class Recorded:
    """An update as a graph.

    Attributes:
        graph: From (*state, *slots, *inputs, *constants) to (*state, *slots, *terms), of what
            changes of state and slots.
        changed: Whether each tensor of state and slots changes.
        terms: Names of the terms of J.
        constants: Tensors that the update looks up.
    """

    graph: GraphModule
    changed: tuple[bool, ...]
    terms: tuple[str, ...]
    constants: tuple[Tensor, ...]


def record(
    modules: Modules,
    state: dict[str, Tensor],
    channels: Sequence[Channeled],
    inputs: Sequence[Tensor],
    clip: Clip | None,
) -> Recorded:
    """Records an update of an agent.

    Args:
        modules: Of the agent.
        state: Parameters and buffers by name.
        channels: How they are moved.
        inputs: Prices, (k,); the scale of each channel's rate, (2,); rates, (2,); states and
            signals of the worlds; number of the update; and key of the stream.
        clip: Clips gradients, or None.

    Raises:
        Untraceable: If the update asks for values, or depends on more than its inputs.
    """
    kept = [slot for channel in channels for slots in channel.slots for slot in slots.values()]
    terms: list[str] = []

    def update(*flat: Tensor) -> list[Tensor]:
        own = dict(zip(state, (tensor.detach().clone() for tensor in flat), strict=False))
        slots = iter([tensor.clone() for tensor in flat[len(state) : len(state) + len(kept)]])
        prices, scales, rates, states, signals, count, key = flat[len(state) + len(kept) :]
        trained = [name for channel in channels for name in channel.names]
        wanted = [own[name].requires_grad_() for name in trained]
        with torch.enable_grad():
            args = (prices.unbind(), World(states, signals), count, key)
            loss, found, buffers = modules.call(own, _loss_and_buffers, *args)
            own.update((name, buffers[name]) for name in own.keys() & buffers.keys())
            gradients = torch.autograd.grad(loss, wanted, allow_unused=True)
        terms[:] = found
        gradient = dict(zip(trained, gradients, strict=True))
        along = zip(channels, scales * rates, strict=True)
        moved = [s for c, rate in along for s in _step(c, own, gradient, slots, rate, clip)]
        return [tensor.detach() for tensor in (*own.values(), *moved, *found.values())]

    def once() -> None:
        """As it is, which fills what is worked out once."""
        own = {name: tensor.detach().clone() for name, tensor in state.items()}
        prices, _, _, states, signals, count, key = inputs
        args = (prices.unbind(), World(states, signals), count, key)
        modules.call(own, Modules.keyed_loss, *args)

    flat = [tensor.detach().clone() for tensor in (*state.values(), *kept, *inputs)]
    # Without a mode for all, torch makes one for each operation, and keeps Python's stack in it.
    one_mode = TracingContext(FakeTensorMode())
    with nothing_else_changes(modules, flat[0].device, once), tracing(one_mode):
        try:
            recorded = make_fx(functionalize(make_fx(update)(*flat)))(*flat)
        except Exception as error:  # whatever the update's Python raises where it asks for values
            raise Untraceable(str(error).strip().partition("\n")[0]) from error
    constants = _lift_constants(recorded)
    changed = _keep_changed(recorded, len(state) + len(kept))
    return Recorded(recorded, changed, tuple(terms), constants)


def _step(
    channel: Channeled,
    own: dict[str, Tensor],
    gradient: Mapping[str, Tensor | None],
    slots: Iterator[Tensor],
    rate: Tensor,
    clip: Clip | None,
) -> list[Tensor]:
    """Moves the parameters of a channel in place; what its optimizer then keeps of each."""
    filled = [{name: next(slots) for name in kept} for kept in channel.slots]
    gradients = [gradient[name] for name in channel.names]
    if clip is not None:
        clip([g for g in gradients if g is not None])
    step(channel.optimizer, [own[name] for name in channel.names], gradients, filled, rate)
    return [slot for kept in filled for slot in kept.values()]


def _loss_and_buffers(
    modules: Modules, prices: tuple[Tensor, ...], world: World, update: Tensor, key: Tensor
) -> tuple[Tensor, Terms, dict[str, Tensor]]:
    """Loss, terms and what buffers are afterwards, some of which may be new tensors."""
    loss, terms = modules.keyed_loss(prices, world, update, key)
    modules.follow(terms, update)
    return loss, terms, dict(modules.named_buffers())


def _lift_constants(recorded: GraphModule) -> tuple[Tensor, ...]:
    """Turns tensors that a graph looks up into inputs, so that one graph serves many tables."""
    *_, last = (node for node in recorded.graph.nodes if node.op == "placeholder")
    lifted: dict[str, tuple[Node, Tensor]] = {}
    for node in [node for node in recorded.graph.nodes if node.op == "get_attr"]:
        if node.target not in lifted:
            with recorded.graph.inserting_after(last):
                last = recorded.graph.placeholder(f"constant_{len(lifted)}")
            lifted[node.target] = last, getattr(recorded, node.target)
        node.replace_all_uses_with(lifted[node.target][0])
        recorded.graph.erase_node(node)
    recorded.recompile()
    return tuple(tensor.detach() for _, tensor in lifted.values())


def _keep_changed(recorded: GraphModule, count: int) -> tuple[bool, ...]:
    """Leaves out of the first `count` outputs those that are the inputs of the same number."""
    inputs = [node for node in recorded.graph.nodes if node.op == "placeholder"]
    (output,) = (node for node in recorded.graph.nodes if node.op == "output")
    outputs = list(output.args[0])
    changed = tuple(
        _origin(node) is not origin for node, origin in zip(outputs, inputs[:count], strict=False)
    )
    kept = [node for node, changes in zip(outputs, changed, strict=False) if changes]
    output.args = ([*kept, *outputs[count:]],)
    recorded.graph.eliminate_dead_code()
    recorded.recompile()
    return changed


def _origin(node: Node) -> Node:
    """What a node is a copy of."""
    while node.target in (aten.clone.default, aten.detach.default, aten.alias.default):
        node = node.args[0]  # type: ignore[assignment]
    return node
