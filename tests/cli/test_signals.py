"""Ctrl-C and SIGTERM."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from training import assert_same_state

from bra import Agent
from bra.checks.words import amount
from bra.cli import main

TASK = "--data.task=PredatorPrey"
SHORT = [TASK, "--data.updates_per_epoch=4", "--data.batch_size=2", "--baseline=null"]
SHORT += ["--behaviour=null", "--trainer.enable_progress_bar=false", "--trainer.max_epochs=3"]
SIGNALS = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
LOGS = Path("lightning_logs")
LAST = LOGS / "version_0/checkpoints/last.ckpt"


def call(name, **arguments):
    callback = json.dumps({"class_path": f"stopping.{name}", "init_args": arguments})
    return f"--trainer.callbacks+={callback}"


def ended(*words):
    with pytest.raises(SystemExit) as end:
        main([*words])
    return end.value.code


@pytest.fixture(scope="module")
def through(tmp_path_factory):
    """A run that nobody stops."""
    folder = tmp_path_factory.mktemp("through")
    main(["fit", *SHORT, f"--trainer.default_root_dir={folder}"])
    return Agent.load_from_checkpoint(folder / LAST)


@pytest.mark.parametrize(
    ("number", "code", "updates"),
    [
        (signal.SIGINT, 130, 0),
        (signal.SIGTERM, 143, 5),
        (signal.SIGINT, 130, 7),
        pytest.param(signal.SIGTERM, 143, 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 130, 5, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, 7, marks=pytest.mark.slow),
    ],
)
def test_a_training_that_is_stopped_can_go_on(capsys, through, number, code, updates):
    before = [signal.getsignal(one) for one, _ in SIGNALS]
    assert ended("fit", *SHORT, call("SignalAfter", number=number, updates=updates)) == code
    assert [signal.getsignal(one) for one, _ in SIGNALS] == before
    said = capsys.readouterr()
    assert said.err.splitlines()[-1] == f"stopped by {signal.Signals(number).name}"
    assert f"stopped after {amount(updates + 1, 'update')}; go on with" in said.out
    summary = json.loads((LOGS / "version_0/summary.json").read_text())
    assert summary["updates"] == updates + 1
    program, *command = shlex.split(said.out.splitlines()[-1])
    assert program == "bra"
    # That of the test would be sent again.
    config = Path(command[1].removeprefix("--config="))
    config.write_text(config.read_text().replace(f"updates: {updates}\n", "updates: 100\n"))
    main([*command, "--behaviour=null"])
    resumed = LOGS / "version_1/checkpoints/last.ckpt"
    assert_same_state(through, Agent.load_from_checkpoint(resumed))


@pytest.mark.parametrize(
    ("number", "code", "command", "hook"),
    [
        (signal.SIGINT, 130, "fit", "on_fit_start"),
        (signal.SIGTERM, 143, "test", "on_test_start"),
        pytest.param(signal.SIGTERM, 143, "fit", "on_fit_start", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 130, "test", "on_test_start", marks=pytest.mark.slow),
    ],
)
def test_other_phases_end_with_one_line(capsys, command, hook, number, code):
    assert ended(command, *SHORT, call("SignalIn", number=number, hook=hook)) == code
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert lines[-1] == f"stopped by {signal.Signals(number).name}"
    assert not any("Traceback" in line for line in lines)


def test_a_run_with_checkpoints_of_its_own_is_saved_too(capsys):
    own = json.dumps({"class_path": "ModelCheckpoint", "init_args": {"every_n_train_steps": 100}})
    words = [f"--trainer.callbacks+={own}", call("SignalAfter", number=signal.SIGINT, updates=2)]
    assert ended("fit", *SHORT, *words) == 130
    assert Agent.load_from_checkpoint(LOGS / "version_0/interrupted.ckpt").updates == 3
    assert "lightning_logs/version_0/interrupted.ckpt\n" in capsys.readouterr().out


@pytest.mark.parametrize(("number", "code"), SIGNALS)
def test_while_modules_load(number, code):
    """Which is said before the seconds pass."""
    command = [sys.executable, "-X", "importtime", "-m", "bra", "fit", *SHORT]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    before = "".join(iter(run.stderr.readline, "bra fit: loading torch …\n"))
    assert "| bra.cli" in before and not re.search(r"\| +torch\b", before)
    time.sleep(0.1)
    run.send_signal(number)
    _, said = run.communicate(timeout=60)
    assert run.returncode == code
    words = [line for line in said.splitlines() if not line.startswith("import time:")]
    assert words == ["", f"stopped by {signal.Signals(number).name}"]
