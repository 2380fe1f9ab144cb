"""What an agent adds to Lightning's checkpoints, and reads from them."""

import os
import pickle
from typing import Any

import torch

from bra.recipes import Recipe, describe_recipe, same_recipe

KEY = "bra"
FIXED_PARTS = ("task", "percepts", "perception", "action")
"""Parts of an agent that a checkpoint must share with the agent that goes on from it."""


def read_checkpoint(path: str | os.PathLike[str], map_location: Any = None) -> dict[str, Any]:
    """Reads a checkpoint of an agent, plain data and tensors only.

    Raises:
        OSError: If there is no such file.
        ValueError: If the file is no checkpoint of an agent.
    """
    try:
        checkpoint = torch.load(path, map_location=map_location, weights_only=True)
    except (RuntimeError, EOFError, LookupError, pickle.UnpicklingError) as error:
        raise ValueError(f"{path} is no checkpoint of a bra.Agent: {error}") from error
    if not isinstance(checkpoint, dict) or KEY not in checkpoint:
        raise ValueError(f"{path} is no checkpoint of a bra.Agent: it lacks the key {KEY!r}")
    return checkpoint


def check_same_parts(saved: dict[str, Recipe], own: dict[str, Recipe]) -> None:
    """Compares the recipes of the agent in a checkpoint and of the one that is to go on.

    Raises:
        ValueError: If task, percepts or channels differ.
    """
    for part in FIXED_PARTS:
        if not same_recipe(saved[part], own[part]):
            raise ValueError(
                f"the checkpoint has {part} {describe_recipe(saved[part])}, this agent "
                f"{describe_recipe(own[part])}; resume with the configuration it was trained with"
            )


def reopen_epoch(fit_loop: dict[str, Any]) -> None:
    """Marks an epoch as going on if it was stopped halfway, by `max_steps` or `max_time`, say.

    Lightning counts such an epoch as done, and would start the next one when the run is resumed.

    Args:
        fit_loop: The state of Lightning's fit loop, changed in place.
    """
    if fit_loop["epoch_loop.batch_progress"]["is_last_batch"]:
        return
    for progress in (fit_loop["epoch_progress"]["current"], fit_loop["epoch_progress"]["total"]):
        progress["processed"] = min(progress["processed"], max(progress["started"] - 1, 0))
        progress["completed"] = min(progress["completed"], progress["processed"])
