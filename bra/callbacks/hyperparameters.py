"""What a run was made of, for loggers that compare runs."""

from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.loggers import TensorBoardLogger

from bra.agent import Learner
from bra.checkpoints.recipes import Recipe


def log_hyperparameters(
    trainer: pl.Trainer, learner: Learner, metrics: dict[str, float | None]
) -> None:
    """Hands prices, parts and seed to all loggers, and to TensorBoard what came out beside them.

    What is not there, a schedule say, has no place in tables of runs.
    """
    recipe = learner.recipe.items()
    parameters = {name: _in_short(part) for name, part in recipe if part is not None}
    known = {f"run/{name}": value for name, value in metrics.items() if value is not None}
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger):
            logger.log_hyperparams(parameters, known)
        else:
            logger.log_hyperparams(parameters)


def _in_short(recipe: Recipe) -> Any:
    """Numbers and words as they are, objects by the names of their classes."""
    if isinstance(recipe, dict) and "class_path" in recipe:
        arguments = recipe["init_args"]
        name = recipe["class_path"].rpartition(".")[2]
        return arguments["n"] if name == "Discrete" else name
    return recipe if isinstance(recipe, int | float | str | None) else str(recipe)
