"""A step of torch's optimizers as a function of tensors."""

import copy
import inspect
from collections import defaultdict
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torch.optim import SGD, Adam, AdamW, Optimizer

TRACEABLE = (SGD, Adam, AdamW)
"""Optimizers whose steps depend on nothing but tensors."""

Slots = dict[str, Tensor]
"""What an optimizer keeps of a parameter, such as its momentum."""
COUNT = "step"
"""The slot that counts steps, one number for all agents, float32 and exact to 2²⁴."""


def slots_of(optimizer: Optimizer) -> list[Slots] | str:
    """What it keeps of each of its parameters; if it cannot be traced, the reason."""
    name = type(optimizer).__name__
    if type(optimizer) not in TRACEABLE:
        return f"{name} is none of {', '.join(cls.__name__ for cls in TRACEABLE)}"
    if len(optimizer.param_groups) != 1:
        return f"{name} has several groups of parameters"
    if optimizer._optimizer_step_pre_hooks or optimizer._optimizer_step_post_hooks:
        return f"something is hooked to the steps of {name}"
    (group,) = optimizer.param_groups
    return [dict(optimizer.state.get(parameter, {})) for parameter in group["params"]]


def has_slots(optimizer: Optimizer) -> bool:
    """Whether it keeps already what it will, which the first step makes."""
    plain = type(optimizer) is SGD and not optimizer.param_groups[0]["momentum"]
    return plain or bool(optimizer.state) or type(optimizer) not in TRACEABLE


def step(
    optimizer: Optimizer,
    parameters: Sequence[Tensor],
    gradients: Sequence[Tensor | None],
    slots: Sequence[Mapping[str, Tensor]],
    rate: Tensor,
) -> None:
    """Makes one step on tensors in place of the optimizer's own, changing them.

    Args:
        optimizer: Gives the settings, and is left alone.
        parameters: In place of its parameters.
        gradients: Of these; what has none stays.
        slots: In place of what it keeps of them.
        rate: Learning rate, of shape ().
    """
    stand_in = copy.copy(optimizer)
    # The variants of torch that take a tensor for the learning rate.
    options = {"foreach": False, "fused": False, "differentiable": True}
    group = optimizer.param_groups[0] | {"params": list(parameters), "lr": rate.requires_grad_()}
    stand_in.param_groups = [group | {k: v for k, v in options.items() if k in group}]
    # Powers such as β₂ⁿ are taken of the count, and want its type to be as exact as theirs.
    own = [{n: s.double() if n == COUNT else s for n, s in kept.items()} for kept in slots]
    stand_in.state = defaultdict(dict, zip(parameters, own, strict=True))
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient
    with torch.no_grad():
        inspect.unwrap(type(optimizer).step)(stand_in)  # without the profiler's marks
        for kept, counted in zip(slots, own, strict=True):
            if COUNT in kept:
                kept[COUNT].copy_(counted[COUNT])
