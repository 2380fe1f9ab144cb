"""The progress bar."""

import time
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.callbacks import TQDMProgressBar
from lightning.pytorch.callbacks.progress.tqdm_progress import Tqdm
from lightning.pytorch.trainer.states import TrainerFn

PAUSE = 0.1
"""Seconds between two drawings, of which each takes as long as several updates."""


class UpdateBar(TQDMProgressBar):
    """A bar over the updates of an epoch that shows J and its gap to the optimum.

    It is drawn ten times a second at most, in notebooks, too.
    """

    def __init__(self) -> None:
        super().__init__()
        self._drawn = 0.0

    def on_train_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Draws the bar if it is time to, or if the epoch is over."""
        bar = self.train_progress_bar
        bar.n = trainer.fit_loop.epoch_loop.batch_idx + 1  # the last of a block
        now = time.monotonic()
        if not bar.disable and (bar.n == bar.total or now - self._drawn >= PAUSE):
            self._drawn = now
            bar.set_postfix(self.get_metrics(trainer, pl_module))

    def init_sanity_tqdm(self) -> Tqdm:
        """None: one evaluation is over before it could be read."""
        return Tqdm(disable=True)

    def init_validation_tqdm(self) -> Tqdm:
        """None within a fit, for the same reason."""
        if self.trainer.state.fn == TrainerFn.FITTING:
            return Tqdm(disable=True)
        return super().init_validation_tqdm()

    def get_metrics(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule
    ) -> dict[str, int | str | float | dict[str, float]]:
        """What the monitors know, and nothing of the logger's version."""
        metrics: dict[str, Any] = super().get_metrics(trainer, pl_module)
        metrics.pop("v_num", None)
        return metrics
