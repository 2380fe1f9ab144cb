"""Runs of several processes, and what becomes of them when one is killed."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from bra.checkpoints.files import find_flaw

CONFIG = str(Path(__file__).parents[2] / "configs/predator_prey.yaml")
FIT = [sys.executable, "-m", "bra", "fit", "--config", CONFIG, "--baseline=null"]
FIT += ["--trainer.enable_progress_bar=false", "--behaviour=null"]
TWO = ["--trainer.accelerator=cpu", "--trainer.devices=2", "--trainer.strategy=ddp"]
WORKERS = ["--data.workers=2", "--data.batch_size=4"]
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

    def start(*words, before=()):
        with Path("err.txt").open("w") as err, Path("out.txt").open("w") as out:
            run = subprocess.Popen(
                [*before, *FIT, *words], stderr=err, stdout=out, start_new_session=True
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
    lines = Path("err.txt").read_text().splitlines()
    return [line for line in lines if line and not re.search("loading|one by one", line)]


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
    (told,) = error_lines()
    assert told.startswith("error: ") and line in told


def test_workers_and_their_server_end_with_a_trainer_that_is_killed(start):
    run = start(*FOREVER, *WORKERS)
    wait_for(LAST)
    below = descendants(run.pid)
    assert len(below) >= 3
    os.kill(run.pid, signal.SIGKILL)
    assert ends_within(below, 20)


@pytest.mark.parametrize("several", [WORKERS, TWO], ids=["workers", "ranks"])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_to_the_whole_group_is_heard_by_the_trainer_alone(start, several, number, code):
    run = start(*FOREVER, *several)
    wait_for(LAST)
    below = descendants(run.pid)
    os.killpg(run.pid, number)
    assert run.wait(60) == code
    assert ends_within(below, 20)
    assert_stopped_in_order(number)


def test_a_limit_of_time_ends_a_run_in_order(start):
    run = start(*FOREVER, *WORKERS, before=["timeout", "30"])
    assert run.wait(90) == 124
    assert_stopped_in_order(signal.SIGTERM)


def assert_stopped_in_order(number):
    assert error_lines() == [f"stopped by {number.name}"]
    (config, checkpoint) = shlex.split(Path("out.txt").read_text().splitlines()[-1])[2:]
    assert Path(config.removeprefix("--config=")).exists()
    assert not find_flaw(Path(checkpoint.removeprefix("--ckpt_path=")))
    assert json.loads(LAST.parents[1].joinpath("summary.json").read_text())["updates"] > 0
