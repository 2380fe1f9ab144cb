"""Optimizers that step the stacked parameters of many agents, each at its own rate."""

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from bra.agent.optimizers import OptimizerFactory
from bra.checkpoints.recipes import unwrap_factory

PROBE = (2, 3, 4)
PROBE_STEPS = 3


def with_rate(factory: OptimizerFactory, rate: float | None) -> OptimizerFactory:
    """The factory with another learning rate; itself if `rate` is None."""
    return factory if rate is None else _with(factory, lr=rate)


def _with(factory: Callable[..., Optimizer], **own: Any) -> OptimizerFactory:
    return partial(factory, **own)


def stacked_factory(
    factory: OptimizerFactory, rates: Sequence[float | None], name: str
) -> tuple[OptimizerFactory, Tensor | None]:
    """What makes the optimizer of a stack, and what its steps are to be scaled by.

    A step is proportional to the learning rate. So the stack is stepped at the highest rate, and
    the step of each agent scaled down to its own. Optimizers are fused, if they can be, so that
    they pass over memory once.

    Args:
        factory: Makes the optimizer of one agent.
        rates: The learning rate of each agent; None is that of the factory.
        name: Of the factory, for errors.

    Returns:
        The factory, and rate over highest rate of each agent, (R,), or None where they are equal.

    Raises:
        ValueError: If the optimizer does not treat each number by itself, or, where rates differ,
            its step is not proportional to the rate.
    """
    known = torch.tensor([rate for rate in rates if rate is not None], dtype=torch.double)
    highest = known.max().item() if len(known) else None
    scale = known / known.max() if len(set(known.tolist())) > 1 else None
    stacked = with_rate(factory, highest)
    _check_elementwise(stacked, None if scale is None else highest, name)
    cls, own = unwrap_factory(stacked)  # type: ignore[arg-type]  # recipes take nothing else
    if "fused" in inspect.signature(cls).parameters and not {"fused", "foreach"} & own.keys():
        stacked = _with(stacked, fused=True)
    return stacked, scale


def scale_steps(
    parameters: Sequence[nn.Parameter], before: Sequence[Tensor], scale: Tensor
) -> None:
    """Shortens the step of each agent: p ← p₀ + s (p − p₀).

    Args:
        parameters: Stacks p (R, …), after the step.
        before: p₀, the same before it.
        scale: s, (R,), between 0 and 1.
    """
    with torch.no_grad():
        for parameter, old in zip(parameters, before, strict=True):
            weight = scale.to(old).reshape(-1, *[1] * (old.ndim - 1))
            parameter.copy_(torch.lerp(old, parameter, weight))


def _check_elementwise(factory: OptimizerFactory, rate: float | None, name: str) -> None:
    """Steps two small agents as a stack and one by one, the second at half the rate if given."""
    generator = torch.Generator().manual_seed(0)
    stack = nn.Parameter(torch.randn(PROBE, generator=generator))
    apart = [nn.Parameter(row.detach().clone()) for row in stack]
    try:
        optimizers: list[Optimizer] = [
            factory([stack]),
            factory([apart[0]]),
            with_rate(factory, rate and rate / 2)([apart[1]]),
        ]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    for _ in range(PROBE_STEPS):
        before = stack.detach().clone()
        stack.grad = torch.randn(PROBE, generator=generator)
        for parameter, gradient in zip(apart, stack.grad, strict=True):
            parameter.grad = gradient.clone()
        for optimizer in optimizers:
            optimizer.step()
        if rate is not None:
            scale_steps([stack], [before], torch.tensor([1.0, 0.5]))
    if not torch.allclose(stack, torch.stack([*apart]), rtol=1e-4, atol=1e-6):
        lack = "does not treat each parameter by itself"
        if rate is not None:
            lack += ", or its step is not proportional to its learning rate"
        raise ValueError(
            f"{name}: {type(optimizers[0]).__name__} {lack}, so that agents of a population would "
            "disturb each other; use another one, such as Adam or SGD"
        )
