"""Processes that draw ahead of the one that trains."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess

from bra.processes.endings import PAUSE

UNKNOWN = 255
"""What is said of a process whose end the fork server did not live to see."""


def worker_context(module: str) -> BaseContext:
    """How worker processes start: clean ones, since simulators and threads survive no fork.

    Where there is a fork server, it imports a module once for all of them. It does not hear the
    signals that a terminal, SLURM or Docker sends to all processes at once: workers are needed
    until the one that trains has ended in order.

    Args:
        module: What they need.

    Raises:
        ValueError: If they would run the user's script again.
    """
    check_guard()
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from bra.processes.forked import Context

    context = Context()
    context.set_forkserver_preload(["bra.processes.deaf", module])
    return context


def check_guard() -> None:
    """Makes sure that processes that import the script of this one do not run it all again.

    Raises:
        ValueError: If the script does not ask for its `__name__`.
    """
    main = sys.modules["__main__"]
    path = getattr(main, "__file__", None)
    if path is None or getattr(main, "__spec__", None) is not None or not os.path.isfile(path):
        return
    with open(path, encoding="utf-8", errors="replace") as file:
        if "__name__" not in file.read():
            raise ValueError(
                f"data.workers are processes that import {path} and would train, too; put what it "
                'does below `if __name__ == "__main__":`, or take workers=0'
            )


def how_ended(workers: Sequence[BaseProcess]) -> str:
    """What is known of the first of some processes that has ended, or does now; else empty."""
    wait([worker.sentinel for worker in workers], PAUSE)
    codes = (worker.exitcode for worker in workers)
    return next((said_of(code) for code in codes if code is not None), "")


def said_of(code: int) -> str:
    """An exit code of Python's `multiprocessing` in words."""
    if code == UNKNOWN:
        return "ended, or the one that starts them did, and nobody knows why"
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else "of no name"
    hint = "; the system does so if memory runs out, among other reasons: then lower data.workers"
    return f"was killed by signal {-code} ({name}){hint if name == 'SIGKILL' else ''}"
