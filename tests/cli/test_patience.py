"""Words for whoever waits."""

import logging
import re
import time
from types import SimpleNamespace

from jsonargparse import Namespace

from bra.cli import patience
from bra.cli.patience import Progress


def test_a_long_silence_is_broken(monkeypatch, capsys):
    monkeypatch.setattr(patience, "SILENCE", 0.01)
    progress = Progress("bra fit")
    run = Namespace(model=Namespace(percepts=10**6, replicas=1, rates=[0.1]), seed=True)
    run.data = Namespace(batch_size=2000, updates=[3, 10**7], evaluation_worlds=10**3)
    config = Namespace(subcommand="fit", fit=run)
    progress.cli = SimpleNamespace(model=SimpleNamespace(updates=1234), config=config)
    said, end = "", time.monotonic() + 30
    with patience.patience(progress):
        while "\n" not in said and time.monotonic() < end:
            time.sleep(0.01)
            said += capsys.readouterr().err
    assert re.match(r"note: bra fit, after 1,234 updates, has been busy for \d+ s", said)
    assert said.splitlines()[0].endswith(
        "; its largest numbers are data.updates 10,000,000, model.percepts 1,000,000"
    )


def test_lines_are_progress_and_unknown_runs_have_no_numbers():
    progress = Progress("bra export")
    assert (str(progress), progress.large(), progress.lines) == ("bra export", "", 0)
    assert progress.filter(logging.makeLogRecord({})) and progress.lines == 1
