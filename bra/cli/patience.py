"""A word to whoever waits: what a command is at, since when, and with how much memory."""

import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from jsonargparse import Namespace

from bra.checks.words import amount

if TYPE_CHECKING:
    from lightning.pytorch.cli import LightningCLI

SILENCE = 20.0
"""Seconds without progress before the first word; every other one takes twice as long."""
LARGE = 1000
"""Numbers from which on a setting may be why something takes long; how much less is no matter."""


class Progress(logging.Filter):
    """How far a command is.

    Args:
        name: Of the command.

    Attributes:
        cli: What runs it, as soon as there is one.
        lines: Lines that have told of progress; as a filter of a log's handler it counts them.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name, self.lines = name, 0
        self.cli: LightningCLI | None = None

    def filter(self, record: logging.LogRecord) -> bool:
        """Counts a line and lets it through."""
        self.lines += 1
        return True

    def __str__(self) -> str:
        """Where it is."""
        updates = getattr(getattr(self.cli, "model", None), "updates", None)
        return self.name if updates is None else f"{self.name}, after {amount(updates, 'update')},"

    def large(self) -> str:
        """The largest whole numbers of its configuration, as the end of a line; may be empty."""
        config = getattr(self.cli, "config", None)
        found = sorted(_numbers(config[config.subcommand]), reverse=True)[:3] if config else []
        named = ", ".join(f"{key} {n:,}" for n, key in found if n >= found[0][0] / LARGE)
        return f"; its largest numbers are {named}" if named else ""


@contextmanager
def patience(progress: Progress) -> Iterator[None]:
    """Within, a line is printed when there was no progress for long."""
    over = threading.Event()
    if os.environ.get("LOCAL_RANK", "0") == "0":
        threading.Thread(target=_watch, args=(progress, over), daemon=True).start()
    try:
        yield
    finally:
        over.set()


def _watch(progress: Progress, over: threading.Event) -> None:
    seen, since, wait = None, 0.0, SILENCE
    while not over.wait(SILENCE / 20):
        now = (str(progress), progress.lines)
        if now != seen:
            seen, since, wait = now, time.monotonic(), SILENCE
        elif (passed := time.monotonic() - since) >= wait:
            wait *= 2
            line = f"note: {progress} has been busy for {passed:.0f} s{_taken()}{progress.large()}"
            print(line, file=sys.stderr, flush=True)


def _taken() -> str:
    """The memory that this process has taken."""
    if sys.platform != "linux":
        return ""
    import resource

    return f", with {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB of memory"


def _numbers(config: Namespace) -> Iterator[tuple[int, str]]:
    """The large whole numbers of a configuration and their keys."""
    for key, value in config.items():
        for number in _whole(value):
            if number >= LARGE:
                yield number, key


def _whole(value: Any) -> list[int]:
    values = value if isinstance(value, list) else [value]
    return [number for number in values if type(number) is int]
