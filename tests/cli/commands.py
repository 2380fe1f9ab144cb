"""Commands in an empty folder."""

import subprocess
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from bra.cli import main

CONFIGS = Path(__file__).parents[2] / "configs"
TASK = "--data.task=PredatorPrey"
TARGETS = "--data.task.targets=[[1]]"
SHORT = ["--trainer.max_epochs=2", "--data.updates_per_epoch=10"]
QUICK = [*SHORT, "--behaviour=null"]
"""Without pictures, which take longer than the updates."""


def config(name: str) -> str:
    return f"--config={CONFIGS / name}"


def error_line(capsys, *args: str) -> str:
    with pytest.raises(SystemExit) as exit_:
        main(list(args))
    assert exit_.value.code == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert lines[-1].startswith("error: ")
    assert not any("Traceback" in line for line in lines)
    return lines[-1]


def run(*args):
    command = [sys.executable, "-X", "importtime", "-m", "bra", *args]
    return subprocess.run(command, capture_output=True, text=True)


def curves(folder: Path) -> EventAccumulator:
    events = EventAccumulator(str(folder))
    events.Reload()
    return events
