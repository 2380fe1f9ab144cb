"""Ctrl-C and SIGTERM: a command ends in order, and its exit code says by which signal."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ECHO = 1.0
"""Seconds within which a signal that comes twice has come once."""


class Stop:
    """What signals have asked for.

    Attributes:
        signal: The last that came, or None.
        patient: Whether whoever is at work looks at `signal` and ends by itself; a second signal
            stops it at once.
        installed: Whether signals come here.
        echoes: Until when, in seconds of the monotonic clock, the same signal is the same call:
            `timeout`, for example, sends it to the process and to its group.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.patient = False
        self.installed = False
        self.echoes = 0.0

    def __call__(self, number: int, _: FrameType | None) -> None:
        """Handles a signal."""
        now = time.monotonic()
        if number == self.signal and now < self.echoes:
            return
        self.signal, patient, self.patient = signal.Signals(number), self.patient, False
        self.echoes = now + ECHO
        if not patient:
            raise KeyboardInterrupt

    def install(self) -> None:
        """Takes the signals from whoever had them."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self)
        self.installed = True


stop = Stop()


@contextmanager
def stoppable() -> Iterator[None]:
    """Within, a signal ends the command with one line and the code 128 + its number.

    Raises:
        SystemExit: With this code.
    """
    stop.signal, stop.patient, stop.echoes = None, False, 0.0
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        stop.install()
    except ValueError:  # signals are handled by the main thread, which is another one
        yield
        return
    try:
        yield
    except BaseException:
        if stop.signal is None:
            raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        stop.installed = False
    if stop.signal is not None:
        first = os.environ.get("LOCAL_RANK", "0") == "0"
        if first:
            print(f"\nstopped by {stop.signal.name}", file=sys.stderr)
        raise SystemExit(128 + stop.signal if first else 0)
