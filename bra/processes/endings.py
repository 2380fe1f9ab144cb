"""Processes that end with those that they belong to, however these end."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import NoReturn

PARENT = "BRA_PARENT"
"""Variable that tells processes of other ranks which process started them."""
PAUSE = 1.0
"""Seconds between two looks."""


def end_with_trainer(_: int = 0) -> None:
    """Lets a data worker end when the process that trains is gone, which may not be its parent.

    To be called in the worker; takes its number, which it does not need.
    """
    # The trainer hears them, and ends in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: None)  # which programs started by tasks do not inherit
    trainer = multiprocessing.parent_process()
    if trainer is None:
        return

    def wait() -> str:
        trainer.join()
        return ""

    _look(wait)


def end_with_parent() -> None:
    """Lets a process of another rank end when the one that started it is gone."""
    parent = int(os.environ.get(PARENT, os.getppid()))

    def wait() -> str:
        while os.getppid() == parent:
            time.sleep(PAUSE)
        return "the process that started this one is gone"

    _look(wait)


def end_with_children(children: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Lets the process of rank 0 end, and the other ranks with it, when one of them fails."""

    def wait() -> str:
        while not (failed := [rank for rank, p in enumerate(children, 1) if p.poll()]):
            time.sleep(PAUSE)
        for child in children:
            child.kill()
        code = children[failed[0] - 1].returncode
        return f"the process of rank {failed[0]} ended with code {code}, and the run with it"

    _look(wait)


def _look(wait: Callable[[], str]) -> None:
    """Ends the process, whatever it is waiting for, as soon as `wait` returns."""

    def look() -> NoReturn:
        if line := wait():
            print(f"\nerror: {line}; resume from the last checkpoint", file=sys.stderr, flush=True)
        os._exit(2)

    threading.Thread(target=look, daemon=True).start()
