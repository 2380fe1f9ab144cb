"""Commands with a checkpoint and no configuration, which the checkpoint then stands for."""

import itertools
from collections.abc import Sequence
from typing import Any

from bra.checkpoints.files import KEY, read_checkpoint
from bra.checkpoints.recipes import check_classes
from bra.cli.configurations import configuration_files
from bra.cli.errors import fail
from bra.cli.parser import as_setting

COMMANDS = ("validate", "test", "predict")
FOUND = ("last", "best")
"""Checkpoints that are looked for where the configuration's runs lie."""


def lone_checkpoint(command: str, args: Sequence[str]) -> str | None:
    """The checkpoint, if there is nothing else to say what is to be evaluated."""
    path = None
    for arg, following in itertools.pairwise([*args, ""]):
        option, _, value = arg.partition("=")
        if option == "--ckpt_path":
            path = value or following
        elif option in ("--data", "--data.task"):
            return None
    alone = command in COMMANDS and path not in FOUND and not configuration_files(args)
    return path if alone else None


def settings_of(path: str) -> dict[str, Any]:
    """What a configuration would say of task and agent; ends the command if that is not known.

    Classes are those of this package, of plug-ins, and of modules that are loaded.
    """
    try:
        recipe = read_checkpoint(path, "cpu")[KEY]["recipe"]
        check_classes(recipe)
    except OSError as error:
        fail(f"ckpt_path: cannot read {path}: {error.strerror}")
    except ValueError as error:
        fail(f"ckpt_path: {str(error).partition(';')[0]}; give the --config of the run")
    settings = {name: as_setting(part) for name, part in recipe.items() if name != "seed"}
    task = settings.pop("task")
    return {"data.task": task} | {f"model.{name}": part for name, part in settings.items()}
