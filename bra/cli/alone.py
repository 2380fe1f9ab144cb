"""Commands with a checkpoint and no configuration, which the checkpoint then stands for."""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bra.checkpoints.files import KEY, read_checkpoint
from bra.checkpoints.recipes import UntrustedError, check_classes
from bra.cli.configurations import configuration_files
from bra.cli.errors import fail
from bra.cli.functions import run_folder
from bra.cli.parser import as_setting

COMMANDS = ("validate", "test", "predict")
FOUND = ("last", "best")
"""Checkpoints that are looked for where the configuration's runs lie."""


def lone_checkpoint(command: str, args: Sequence[str]) -> str | None:
    """The checkpoint, if there is nothing else to say what is to be evaluated."""
    given = _given(args)
    path = given.get("--ckpt_path")
    alone = command in COMMANDS and path not in FOUND and not configuration_files(args)
    return None if given.keys() & {"--data", "--data.task"} or not alone else path


def trusted_modules(args: Sequence[str]) -> list[str]:
    """Modules of one's own that `--trusted` names."""
    return re.findall(r"[\w.]+", _given(args).get("--trusted", ""))


def _given(args: Sequence[str]) -> dict[str, str]:
    """The options of a command line and their values."""
    pairs = ((arg.partition("="), following) for arg, following in itertools.pairwise([*args, ""]))
    return {option: value if equals else following for (option, equals, value), following in pairs}


def settings_of(path: str, trusted: Sequence[str]) -> dict[str, Any]:
    """What a configuration would say of task and agent; ends the command if that is not known.

    Classes are those of this package, of plug-ins, of modules that are loaded, and of those that
    are trusted.
    """
    try:
        recipe = read_checkpoint(path, "cpu")[KEY]["recipe"]
        check_classes(recipe, trusted)
    except UntrustedError as error:
        config = run_folder(Path(path)) / "config.yaml"
        way = f"give --config {config}, or, " if config.is_file() else ""
        fail(f"ckpt_path: {error.needs}; {way}if you trust its code, add --trusted {error.module}")
    except OSError as error:
        fail(f"ckpt_path: cannot read {path}: {error.strerror}")
    except ValueError as error:
        fail(f"ckpt_path: {error}")
    settings = {name: as_setting(part) for name, part in recipe.items() if name != "seed"}
    task = settings.pop("task")
    return {"data.task": task} | {f"model.{name}": part for name, part in settings.items()}
