"""The progress bar."""

from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.callbacks import TQDMProgressBar


class UpdateBar(TQDMProgressBar):
    """A bar over the updates of an epoch that shows J and its gap to the optimum."""

    def __init__(self) -> None:
        super().__init__(refresh_rate=50)  # each refresh costs as much as several updates

    def get_metrics(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule
    ) -> dict[str, int | str | float | dict[str, float]]:
        """What the monitors know, and nothing of the logger's version."""
        metrics: dict[str, Any] = super().get_metrics(trainer, pl_module)
        metrics.pop("v_num", None)
        return metrics
