"""What the surroundings of a command must not do to it."""

import io
import os
import sys
import threading
import warnings

from bra.cli.errors import fail


def settle_surroundings() -> None:
    """Makes the best of terminals without Greek, and of variables meant for other programs.

    What a terminal or file cannot show becomes `?`, and what goes to a closed one is lost.
    Warnings that were to be errors are shown instead, since libraries warn of what their users
    cannot change. Figures are only written.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # as long as the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if any(option.startswith("error") for option in sys.warnoptions):
        sys.warnoptions[:] = [o.replace("error", "default", 1) for o in sys.warnoptions]
        shown = [("default", *f[1:]) if f[0] == "error" else f for f in warnings.filters]
        warnings.filters[:] = shown  # type: ignore[index]  # a list, whatever it is said to be
    os.environ["MPLBACKEND"] = "agg"
    threading.excepthook = _report


def check_rank() -> None:
    """Ends the command if variables that tell a process its rank tell none."""
    for name in ("RANK", "LOCAL_RANK"):
        rank = os.environ.get(name, "0")
        if not rank.isdecimal():
            fail(f"the variable {name} must be the rank of this process, got {rank!r}; unset it")


def end_of_pipe() -> None:
    """Keeps Python from writing the rest to whoever has stopped reading.

    Raises:
        SystemExit: With the code that shells give to those who write on, 128 + SIGPIPE.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    raise SystemExit(141)


def _report(failure: threading.ExceptHookArgs) -> None:
    """Prints what ended a thread, but for disks: whoever has it write hears of those."""
    if not issubclass(failure.exc_type, OSError):
        threading.__excepthook__(failure)
