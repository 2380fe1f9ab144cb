"""Runs of several processes, and what becomes of them when one is killed."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

CONFIG = str(Path(__file__).parents[2] / "configs/predator_prey.yaml")
FIT = [sys.executable, "-m", "bra", "fit", "--config", CONFIG, "--baseline=null"]
FIT += ["--trainer.enable_progress_bar=false", "--behaviour=null"]
TWO = ["--trainer.accelerator=cpu", "--trainer.devices=2", "--trainer.strategy=ddp"]
FOREVER = ["--trainer.max_epochs=100000", "--data.updates_per_epoch=20"]
LAST = Path("lightning_logs/version_0/checkpoints/last.ckpt")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks for processes in /proc"),
]


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Starts commands that write into a folder, and kills all that is left of them."""
    monkeypatch.chdir(tmp_path)
    runs = []

    def start(*words):
        with Path("err.txt").open("w") as err:
            run = subprocess.Popen(
                [*FIT, *words], stderr=err, stdout=subprocess.DEVNULL, start_new_session=True
            )
        runs.append(run)
        return run

    yield start
    for run in runs:
        with suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)
        run.wait()


def descendants(pid):
    """All processes below this one."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True).stdout
    pairs = [tuple(map(int, line.split())) for line in listed.splitlines()]
    found, new = [], {pid}
    while new:
        new = {child for child, parent in pairs if parent in new}
        found += new
    return found


def ends_within(pids, seconds):
    def alive(pid):
        stat = Path(f"/proc/{pid}/stat")
        return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"

    end = time.monotonic() + seconds
    while left := [pid for pid in pids if alive(pid)]:
        if time.monotonic() > end:
            return False
        time.sleep(0.2)
    return not left


def wait_for(path, seconds=90):
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, Path("err.txt").read_text()
        time.sleep(0.2)


def error_lines():
    return [line for line in Path("err.txt").read_text().splitlines() if "loading" not in line]


def test_two_processes_write_everything_once(start):
    assert start(*TWO, "--trainer.max_epochs=1", "--data.updates_per_epoch=3").wait(90) == 0
    names = sorted(path.name.split(".")[0] for path in Path("lightning_logs").rglob("*.*"))
    expected = ["config", "epoch=0-step=3", "events", "hparams", "last", "summary"]
    assert names == expected and error_lines() == []
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert (summary["updates"], summary["samples"]) == (3, 3)


@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_that_is_killed_ends_the_other(start, rank):
    run = start(*TWO, *FOREVER)
    wait_for(LAST)
    (child,) = descendants(run.pid)
    os.kill((run.pid, child)[rank], signal.SIGKILL)
    assert ends_within([run.pid, child], 20)
    line = ("the process that started this one is gone", "rank 1 ended with code -9")[rank]
    lines = [text for text in error_lines() if text]
    assert len(lines) == 1 and lines[0].startswith("error: ") and line in lines[0]


def test_workers_and_their_server_end_with_a_trainer_that_is_killed(start):
    run = start(*FOREVER, "--data.workers=2", "--data.batch_size=4")
    wait_for(LAST)
    below = descendants(run.pid)
    assert len(below) >= 3
    os.kill(run.pid, signal.SIGKILL)
    assert ends_within(below, 20)
