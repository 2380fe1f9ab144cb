"""Commands whose keys are the arguments of a function."""

import inspect
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from bra.agent.agent import Agent
from bra.checkpoints.recipes import UntrustedError
from bra.checks.memory import limited_memory, missing_memory
from bra.cli.errors import fail
from bra.cli.parser import ArgumentParser
from bra.cli.patience import Progress, patience

FLAGS = ("--gui",)


def find_function(module: str, command: str) -> Callable[..., None]:
    """The function of a module of this package that has the command's name."""
    function: Callable[..., None] = getattr(import_module(f"bra.cli.{module}"), command)
    return function


def run_function(function: Callable[..., None], args: Sequence[str]) -> None:
    """Runs a command."""
    summary, *_ = (function.__doc__ or "").split("\n\n")
    if args and not args[0].startswith("-"):  # the first argument needs no key
        first, *_ = inspect.signature(function).parameters
        args = [f"--{first}={args[0]}", *args[1:]]
    parser = ArgumentParser(prog=f"bra {function.__name__}", description=summary)
    parser.add_function_arguments(function, as_group=False)
    settings = parser.parse_args([f"{arg}=true" if arg in FLAGS else arg for arg in args])
    try:
        with patience(Progress(parser.prog)), limited_memory():
            function(**settings)
    except OSError as error:
        named = error.filename is not None and error.strerror
        fail(f"{os.fsdecode(error.filename)}: {error.strerror}" if named else str(error))
    except (ImportError, MemoryError, RuntimeError, ValueError) as error:
        fail(missing_memory(error) or str(error))


def load_agent(path: str, trusted: Sequence[str] | str) -> Agent:
    """A checkpoint's agent, of a population the best one.

    Modules of one's own are looked for in the current folder, too.

    Raises:
        ValueError: If the file cannot be read, or is no checkpoint of an agent.
    """
    if trusted:
        sys.path.append(os.getcwd())
    try:
        return Agent.load_from_checkpoint(path, "cpu", trusted).eval()
    except UntrustedError as error:
        way = f"if you trust its code, add --trusted {error.module}"
        raise ValueError(f"ckpt_path: {error.needs}; {way}") from error
    except OSError as error:
        raise ValueError(f"ckpt_path: cannot read {path}: {error.strerror}") from error


def run_folder(checkpoint: Path) -> Path:
    """The folder of the run that a checkpoint is from."""
    folder = checkpoint.resolve().parent
    return folder.parent if folder.name == "checkpoints" else folder
