"""Imported by the fork server, which starts with signals blocked, and leaves them so.

Processes that it forks hear them. Where signals are heard, to import this does nothing.
"""

import os
import signal

SIGNALS = (signal.SIGINT, signal.SIGTERM)

if hasattr(signal, "pthread_sigmask"):
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    if blocked.issuperset(SIGNALS):
        os.register_at_fork(
            after_in_child=lambda: signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        )
