"""When monitors look at the agent."""

from abc import ABC, abstractmethod
from typing import Any

import lightning.pytorch as pl
import torch

from bra.agent import Agent
from bra.agent.learner import Learner
from bra.checks import check_count


class Monitor(pl.Callback, ABC):
    """Looks at the agent before the first update, every so many updates, and after the last.

    Of a population it looks at the best agent of the moment.

    Monitors observe: they read the agent and write to the loggers, against the number of updates.

    Args:
        every_n_updates: Updates between two looks.

    Raises:
        ValueError: If `every_n_updates` is less than 1.
    """

    def __init__(self, every_n_updates: int) -> None:
        self.every_n_updates = check_count(every_n_updates, "every_n_updates")
        self._last_look: int | None = None

    @abstractmethod
    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """What there is to do at each look."""

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The first look."""
        self._last_look = None
        self._look(trainer, pl_module)

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *_: Any
    ) -> None:
        """A look every so many updates."""
        if learner_of(pl_module).updates % self.every_n_updates == 0:
            self._look(trainer, pl_module)

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The last look."""
        self._look(trainer, pl_module)

    def _look(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        updates = learner_of(pl_module).updates
        if updates != self._last_look:
            self._last_look = updates
            self.look(trainer, agent_of(pl_module))


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


def log_metrics(trainer: pl.Trainer, agent: Agent, metrics: dict[str, float]) -> None:
    """Writes metrics to all loggers against the number of updates.

    They are `callback_metrics` too, which early stopping, checkpoints and searches go by.
    """
    trainer.callback_metrics.update({n: torch.tensor(value) for n, value in metrics.items()})
    for logger in trainer.loggers:
        logger.log_metrics(metrics, step=agent.updates)
