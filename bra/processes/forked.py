"""Processes of a fork server that does not hear signals."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.forkserver import ensure_running
from multiprocessing.process import BaseProcess
from multiprocessing.resource_tracker import ensure_running as ensure_tracker
from typing import Any

from bra.processes.deaf import SIGNALS


class Worker(ForkServerProcess):
    """One of them."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        ensure_tracker()  # which unblocks signals if it starts another process
        with _blocked():
            ensure_running()
        started: Any = ForkServerProcess._Popen(process_obj)
        started.terminate = started.kill  # since it leaves SIGTERM to the one that trains
        return started


class Context(ForkServerContext):
    """Starts them."""

    Process = Worker


@contextmanager
def _blocked() -> Iterator[None]:
    """Within, processes start with signals blocked."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
