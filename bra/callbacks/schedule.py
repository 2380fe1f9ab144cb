"""When monitors look at the agent."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, cast
from weakref import WeakKeyDictionary

import lightning.pytorch as pl
import torch
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from bra.agent import Agent
from bra.agent.learner import Learner
from bra.callbacks.events import is_plain, write_numbers
from bra.checks.settings import check_count

HUNDRED = 100
"""Updates by whose multiples monitors look in long runs, so that blocks of updates stay long."""
POINTS = 100
"""Points of the curves of a long run."""
JUDGED = 256
"""Agents that are judged in the time of some hundred updates of theirs."""

_ROWS: WeakKeyDictionary[pl.Trainer, dict[str, float]] = WeakKeyDictionary()
"""What monitors have measured since loggers were written to."""


class Monitor(pl.Callback, ABC):
    """Looks at the agent before the first update, every so many updates, and after the last.

    Of a population it looks at the best agent of the moment.

    Monitors observe: they read the agent and write to the loggers, against the number of updates.
    What all of them measure after one update is one row.

    Args:
        every_n_updates: Updates between two looks; None is some `looks` of them in a run.

    Raises:
        ValueError: If `every_n_updates` is less than 1.
    """

    looks: ClassVar[int] = 8

    def __init__(self, every_n_updates: int | None) -> None:
        self._fixed = every_n_updates is not None
        if every_n_updates is not None:
            every_n_updates = check_count(every_n_updates, "every_n_updates")
        self.every_n_updates = every_n_updates
        self._last_look: int | None = None

    @abstractmethod
    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """What there is to do at each look."""

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The first look."""
        self._last_look = None
        if not self._fixed:
            self.every_n_updates = self._part_of(learner_of(pl_module))
        self._look(trainer, pl_module)

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *_: Any
    ) -> None:
        """A look every so many updates."""
        if learner_of(pl_module).updates % (self.every_n_updates or 1) == 0:
            self._look(trainer, pl_module)

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *_: Any
    ) -> None:
        """Writes what all monitors have measured after the last update."""
        write_row(trainer, pl_module)

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The last look."""
        self._look(trainer, pl_module)
        callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
        if self is next((c for c in reversed(callbacks) if isinstance(c, Monitor)), self):
            write_row(trainer, pl_module)

    def on_exception(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException
    ) -> None:
        """Writes what there is."""
        write_row(trainer, pl_module)

    def _part_of(self, learner: Learner) -> int:
        """Some of the updates at which curves have points, so that one judgement serves all."""
        part, apart = max(1, (learner.run or 1) // self.looks), between_points(learner)
        return part if part < apart == HUNDRED else -(-part // apart) * apart

    def _look(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        updates = learner_of(pl_module).updates
        if updates != self._last_look:
            self._last_look = updates
            self.look(trainer, agent_of(pl_module))


class CurveMonitor(Monitor):
    """Draws curves: every 100 updates, or a hundred points of a longer run.

    Of more than 256 agents every 200 updates, of more than 512 every 300, and so on, lest judging
    them take longer than training them.
    """

    def _part_of(self, learner: Learner) -> int:
        return between_points(learner)


def between_points(learner: Learner) -> int:
    """Updates between two points of the curves."""
    part = -(-((learner.run or 1) // POINTS) // HUNDRED) * HUNDRED
    return max(part, HUNDRED * -(-len(learner.settings) // JUDGED))


def learner_of(pl_module: pl.LightningModule) -> Learner:
    """The module as an agent or a population.

    Raises:
        TypeError: If it is neither.
    """
    if not isinstance(pl_module, Learner):
        raise TypeError(f"monitors watch a bra.Agent, got {type(pl_module).__name__}")
    return pl_module


def agent_of(pl_module: pl.LightningModule) -> Agent:
    """The module as an agent; of a population the best one.

    Raises:
        TypeError: If it is neither.
    """
    return learner_of(pl_module).best_agent()


def log_metrics(trainer: pl.Trainer, metrics: dict[str, float]) -> None:
    """Adds what a monitor has measured to the row of this update.

    It is in `callback_metrics` at once, which early stopping, checkpoints and searches go by.
    """
    trainer.callback_metrics.update({n: torch.tensor(value) for n, value in metrics.items()})
    _ROWS.setdefault(trainer, {}).update(metrics)


def write_row(trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
    """Hands the row to all loggers, if there is one.

    A CSV logger saves it right away; by its own count it would do so hardly ever.
    """
    if row := _ROWS.pop(trainer, None):
        updates = learner_of(pl_module).updates
        for logger in trainer.loggers:
            if is_plain(logger) and trainer.is_global_zero:
                write_numbers(cast(TensorBoardLogger, logger), row, updates)
                continue
            logger.log_metrics(row, step=updates)
            if isinstance(logger, CSVLogger):
                logger.save()
