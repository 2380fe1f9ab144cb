"""Pictures for every logger that can take one."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import numpy as np
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only
from PIL.Image import Image

from bra.callbacks.events import write_picture

Take = Callable[[str, Image, int], object]
"""Takes a picture by its name, and the number of updates that it was drawn after."""


@rank_zero_only
def log_pictures(
    trainer: pl.Trainer, group: str, updates: int, draw: Callable[[], dict[str, Image]]
) -> None:
    """Hands pictures to TensorBoard, Weights & Biases, MLflow, and to other loggers that can.

    That is, to those with a method `log_image(key, images, step)`. Beside the curves of a CSV
    logger they are files, `GROUP/NAME-UPDATES.png`.

    Args:
        trainer: Knows its loggers.
        group: Stands before the names, as in `GROUP/NAME`.
        updates: What the pictures are drawn after.
        draw: Draws the pictures by name; not called if no logger takes any.
    """
    takers = [take for logger in trainer.loggers if (take := _taker(logger))]
    for name, picture in draw().items() if takers else ():
        for take in takers:
            take(f"{group}/{name}", picture, updates)


def _taker(logger: Logger) -> Take | None:
    """How a logger takes a picture; None if it does not."""
    if isinstance(logger, TensorBoardLogger):
        return partial(write_picture, logger)
    if isinstance(logger, CSVLogger):
        return partial(_to_file, Path(logger.log_dir))
    if isinstance(logger, MLFlowLogger):
        return partial(_to_mlflow, logger)
    if log_image := getattr(logger, "log_image", None):  # as WandbLogger has it
        return lambda name, picture, updates: log_image(name, [picture], updates)
    return None


def _to_mlflow(logger: MLFlowLogger, name: str, picture: Image, updates: int) -> None:
    logger.experiment.log_image(logger.run_id, np.asarray(picture), key=name, step=updates)


def _to_file(folder: Path, name: str, picture: Image, updates: int) -> None:
    path = folder / f"{name}-{updates:07}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)
