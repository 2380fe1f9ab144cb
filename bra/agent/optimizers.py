"""The optimizers of both channels, and their schedules."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from numbers import Real
from typing import Any

from torch import nn
from torch.optim import LBFGS, Optimizer, SparseAdam
from torch.optim.lr_scheduler import LRScheduler, OneCycleLR, ReduceLROnPlateau

from bra.checkpoints.recipes import unwrap_factory
from bra.checks.settings import check_count
from bra.checks.words import amount

OptimizerFactory = Callable[[Iterable[Any]], Optimizer]
SchedulerFactory = Callable[[Optimizer], LRScheduler]

DIVERGED = 1e30
"""Size of a number beyond which sums of float32 products overflow."""
NAMES = ("perception_optimizer", "action_optimizer")
SCHEDULERS = ("perception_scheduler", "action_scheduler")
UNFIT = {
    LBFGS: "needs the loss several times per update",
    SparseAdam: "takes sparse gradients alone, and channels have dense ones",
}
"""Optimizers that cannot train a channel, and why."""
LENGTHS = (
    *("step_size", "T_max", "T_0", "total_iters", "total_steps", "epochs", "steps_per_epoch"),
    *("step_size_up", "step_size_down"),
)
"""Arguments of schedules that count updates."""


def check_factory(factory: Any, name: str, kind: type) -> None:
    """Makes sure that a factory is one.

    Raises:
        TypeError: If it cannot be called, or is an object of the kind that it is to make.
    """
    if isinstance(factory, kind) or not callable(factory):
        got = " ".join(repr(factory).split())
        raise TypeError(
            f"{name} must be a class of kind {kind.__name__}, or a functools.partial of one, "
            f"got {got:.60}"
        )


def make_optimizers(
    factories: Sequence[OptimizerFactory], parameters: Iterable[Iterable[nn.Parameter]]
) -> list[Optimizer]:
    """One optimizer per channel.

    Raises:
        TypeError: If a factory is none.
        ValueError: If a factory refuses, a learning rate is negative or not finite, or an optimizer
            needs more than one gradient per update.
    """
    optimizers = []
    for name, factory, trained in zip(NAMES, factories, parameters, strict=True):
        check_factory(factory, name, Optimizer)
        try:
            optimizer = factory(trained)
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{name}: {error}") from error
        for kind, reason in UNFIT.items():
            if isinstance(optimizer, kind):
                raise ValueError(f"{name}: {kind.__name__} {reason}; use another optimizer")
        for rate in _rates(optimizer):
            if not 0 <= rate < math.inf:
                raise ValueError(f"{name}: lr must be finite and at least 0, got {rate}")
        optimizers.append(optimizer)
    return optimizers


def at_rest(optimizers: Sequence[Optimizer]) -> Iterator[str]:
    """A line for each channel that does not learn, since its learning rate is 0."""
    for name, optimizer in zip(NAMES, optimizers, strict=True):
        rates = [group.get("initial_lr", group.get("lr")) for group in optimizer.param_groups]
        if all(rate == 0 for rate in rates):
            yield f"note: {name} has a learning rate of 0: its channel stays as it starts"


def make_schedulers(
    factories: Sequence[SchedulerFactory | None], optimizers: Sequence[Optimizer]
) -> list[LRScheduler]:
    """The schedules that are asked for.

    Raises:
        TypeError: If a factory is none.
        ValueError: If a factory refuses, a length is no whole number of at least 1, another number
            negative or not finite, or a schedule waits for a metric.
    """
    schedulers = []
    for name, factory, optimizer in zip(SCHEDULERS, factories, optimizers, strict=True):
        if factory is None:
            continue
        check_factory(factory, name, LRScheduler)
        _check_schedule(factory, name)
        try:
            schedulers.append(factory(optimizer))
        except (TypeError, ValueError, ArithmeticError) as error:
            raise ValueError(f"{name}: {error}") from error
    return schedulers


def check_lengths(schedulers: Sequence[LRScheduler], updates: int) -> None:
    """Makes sure that schedules do not end before the run does.

    Raises:
        ValueError: If one does.
    """
    for scheduler in schedulers:
        if isinstance(scheduler, OneCycleLR) and scheduler.total_steps < updates:
            raise ValueError(
                f"OneCycleLR ends after total_steps {scheduler.total_steps:,}, and this run makes "
                f"{amount(updates, 'update')}; give it as many"
            )


def _rates(optimizer: Optimizer) -> Iterator[float]:
    return (float(group["lr"]) for group in optimizer.param_groups if "lr" in group)


def _check_schedule(factory: SchedulerFactory, name: str) -> None:
    if not isinstance(factory, type | partial):  # which no checkpoint holds
        return
    cls, arguments = unwrap_factory(factory)
    if issubclass(cls, ReduceLROnPlateau):
        raise ValueError(
            f"{name}: ReduceLROnPlateau waits for a metric, schedules here follow the updates; "
            "use another scheduler"
        )
    for key, value in arguments.items():
        if key in LENGTHS and value is not None:
            check_count(value, f"{name}: {key}")
        elif isinstance(value, Real) and key != "last_epoch" and not 0 <= float(value) < math.inf:
            raise ValueError(f"{name}: {key} must be finite and at least 0, got {value}")


def step_schedules(schedulers: Sequence[LRScheduler]) -> None:
    """Moves the learning rates on.

    Raises:
        FloatingPointError: If one is no number that parameters can be moved by.
    """
    for scheduler in schedulers:
        scheduler.step()
        for rate in (float(group["lr"]) for group in scheduler.optimizer.param_groups):
            if not abs(rate) < DIVERGED:
                raise FloatingPointError(
                    f"{type(scheduler).__name__} leads to a learning rate of {rate:g} in "
                    f"update {scheduler.last_epoch}; choose a milder schedule"
                )
