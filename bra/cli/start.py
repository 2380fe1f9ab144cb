"""Where the command starts: what can be said before torch is loaded, which takes seconds."""

import errno
import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bra.cli.configurations import (
    check_arguments,
    check_configuration,
    configuration_files,
)
from bra.cli.errors import fail, suggest
from bra.cli.signals import stoppable
from bra.cli.surroundings import check_rank, end_of_pipe, settle_surroundings

COMMANDS = {
    "fit": "Trains an agent, or a population, and holds it against its optimum.",
    "validate": "Evaluates a trained agent: J and its terms.",
    "test": "The same, under the name that Lightning has for it.",
    "predict": "Lets a trained agent act, and writes down what it did.",
    "baseline": "Solves for the Blahut-Arimoto optimum, without training.",
    "frontier": "Draws what information earns along prices, with its optimum and bound.",
    "export": "Writes the tables of a trained agent and of its optimum as CSV.",
    "reproduce": "Works optima of the literature out again; without a name, lists them.",
    "rollout": "Lets a trained agent see mugs and lift them, on film.",
    "outcomes": "Measures which action of the robot lifts which mug.",
    "help": "Lists tasks, channels, rules and other classes, and their settings.",
}
FUNCTIONS = {
    "export": "export",
    "reproduce": "reproduce",
    "rollout": "robot",
    "outcomes": "robot",
    "help": "help",
}
"""Commands that need no configuration, and the modules of their functions."""
PAGE = """\
usage: bra COMMAND [--config FILE] [--KEY VALUE ...]

Trains bounded-rational agents and holds them against the certified optimum.

commands:
{commands}

`bra COMMAND --help` lists the keys of a command with their types and defaults, `bra help MLP` the
settings of a class; `bra --version` tells the version."""


def main(args: Sequence[str] | None = None) -> None:
    """Runs the command.

    Args:
        args: Arguments after the command's name; None takes those of the process.

    Raises:
        SystemExit: With code 2 after one line `error: …` on standard error, if the input is
            wrong; with 130 or 143 if Ctrl-C or SIGTERM ended it; with 141 if nobody reads on.
    """
    settle_surroundings()
    try:
        answer(list(sys.argv[1:] if args is None else args))
        sys.stdout.flush()
    except BrokenPipeError:
        end_of_pipe()
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        fail(f"cannot write what there is to say: {error.strerror}")


def answer(args: Sequence[str]) -> None:
    """Runs a command, or says what there is."""
    match args:
        case []:
            fail(f"a command is needed: {', '.join(COMMANDS)}; see bra --help")
        case ["-h" | "--help", *_]:
            lines = (f"  {name:10}{text}" for name, text in COMMANDS.items())
            print(PAGE.format(commands="\n".join(lines)))
        case ["--version", *_]:
            from importlib.metadata import version

            print(f"bra {version('bra')}")
        case [command, *_] if command not in COMMANDS:
            fail(f"unknown command {command}; {suggest(command, COMMANDS)}")
        case [command, *rest]:
            with stoppable():
                run(command, rest)


def run(command: str, args: Sequence[str]) -> None:
    """Looks at the configurations, then loads what the command needs, and runs it."""
    files = configuration_files(args)
    for file in files:
        check_configuration(file)
    check_arguments(args)
    check_rank()
    if "torch" not in sys.modules:
        words = " ".join(["bra", command, *map(str, files)])
        print(f"{words}: loading torch …", file=sys.stderr, flush=True)
    with quick_imports():
        from bra.cli.plugins import load_plugins

        if command in FUNCTIONS:
            from bra.cli.functions import find_function, run_function

            function = find_function(FUNCTIONS[command], command)
        else:
            from bra.cli.command import run_command
    load_plugins()
    if command in FUNCTIONS:
        run_function(function, args)
    else:
        run_command(command, args)


@contextmanager
def quick_imports() -> Iterator[None]:
    """Keeps Python from looking for garbage in what is imported: a fifth of start-up."""
    collects, first = gc.isenabled(), "torch" not in sys.modules
    gc.disable()
    try:
        yield
    finally:
        if first:
            gc.freeze()
        if collects:
            gc.enable()
