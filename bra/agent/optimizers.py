"""The optimizers of both channels, and their schedules."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from torch import nn
from torch.optim import LBFGS, Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau

OptimizerFactory = Callable[[Iterable[Any]], Optimizer]
SchedulerFactory = Callable[[Optimizer], LRScheduler]

NAMES = ("perception_optimizer", "action_optimizer")


def make_optimizers(
    factories: Sequence[OptimizerFactory], parameters: Iterable[Iterable[nn.Parameter]]
) -> list[Optimizer]:
    """One optimizer per channel.

    Raises:
        ValueError: If a factory refuses, or an optimizer needs more than one gradient per update.
    """
    optimizers = []
    for name, factory, trained in zip(NAMES, factories, parameters, strict=True):
        try:
            optimizer = factory(trained)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
        if isinstance(optimizer, LBFGS):
            raise ValueError(
                f"{name}: LBFGS needs the loss several times per update; use another optimizer"
            )
        optimizers.append(optimizer)
    return optimizers


def make_schedulers(
    factories: Sequence[SchedulerFactory | None], optimizers: Sequence[Optimizer]
) -> list[LRScheduler]:
    """The schedules that are asked for.

    Raises:
        ValueError: If a schedule waits for a metric.
    """
    pairs = zip(factories, optimizers, strict=True)
    schedulers = [factory(optimizer) for factory, optimizer in pairs if factory is not None]
    for scheduler in schedulers:
        if isinstance(scheduler, ReduceLROnPlateau):
            raise ValueError(
                "ReduceLROnPlateau waits for a metric, schedules here follow the updates; use "
                "another scheduler"
            )
    return schedulers
