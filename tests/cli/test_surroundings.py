"""Terminals, pipes and variables that were made for other programs."""

import contextlib
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from bra.cli import main
from bra.cli.surroundings import settle_surroundings

FIT = [
    *("fit", "--data.task=PredatorPrey", "--trainer.max_epochs=1", "--data.updates_per_epoch=4"),
    *("--trainer.enable_progress_bar=false", "--behaviour=null", "--baseline=null"),
]
SLURM = {
    "NTASKS": "4",
    "JOB_NAME": "x",
    "JOB_ID": "3",
    "PROCID": "0",
    "LOCALID": "0",
    "NODEID": "0",
}


@pytest.fixture(autouse=True)
def without_windows(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_terminals_without_greek(monkeypatch, encoding):
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding))
    main(FIT)
    assert "I(?;X) bits" in shown.getvalue().decode(encoding)
    assert Path("lightning_logs/version_0/summary.json").exists()


def test_whoever_stops_reading_ends_the_command(monkeypatch):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        with pytest.raises(SystemExit) as end:
            main(["--help"])
    assert end.value.code == 141


def test_a_terminal_that_is_closed_shows_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    main(FIT)
    assert Path("lightning_logs/version_0/summary.json").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_disk_behind_the_help_is_one_line(monkeypatch, capsys):
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        with pytest.raises(SystemExit) as end:
            main(["--help"])
        with contextlib.suppress(OSError):
            full.close()
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "error: cannot write what there is to say: No space left on device"


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("LOCAL_RANK", "abc", "LOCAL_RANK must be the rank of this process, got 'abc'; unset it"),
        ("LOCAL_RANK", "1", "one device, and the variable LOCAL_RANK says that the process is nu"),
        ("RANK", "3", "RANK says that the process is number 3 of several; unset it, or set"),
    ],
)
def test_ranks_of_other_programs_are_told(monkeypatch, capsys, name, value, said):
    monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as end:
        main(FIT)
    line = capsys.readouterr().err.splitlines()[-1]
    assert end.value.code == 2 and line.startswith("error: ") and said in line


def test_tasks_of_slurm_are_none_of_a_run_on_one_device(monkeypatch):
    for name, value in SLURM.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    main(FIT)
    assert Path("lightning_logs/version_3/summary.json").exists()  # numbered by the job


@pytest.mark.parametrize("seed", ["abc", "-1", "4294967296"])
def test_a_seed_from_outside_that_is_none(monkeypatch, capsys, seed):
    monkeypatch.setenv("PL_GLOBAL_SEED", seed)
    with pytest.raises(SystemExit) as end:
        main([*FIT, "--seed_everything=true"])
    assert end.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"error: PL_GLOBAL_SEED must be at least 0 and less than 2³², got {seed}"


def test_warnings_are_no_errors(monkeypatch):
    monkeypatch.setattr(sys, "warnoptions", ["error", "error::UserWarning", "ignore"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        settle_surroundings()
        assert sys.warnoptions == ["default", "default::UserWarning", "ignore"]
        with pytest.warns(UserWarning, match="all of it"):
            warnings.warn("all of it", UserWarning, stacklevel=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONOPTIMIZE": "2"},
        {"PYTHONWARNINGS": "error"},
        {"MPLBACKEND": "nonsense"},
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONUTF8": "0", "LC_ALL": "C"},
    ],
)
def test_variables_of_python(variables):
    command = [sys.executable, "-m", "bra", *FIT]
    done = subprocess.run(command, env=os.environ | variables, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert Path("lightning_logs/version_0/summary.json").exists()


@pytest.mark.slow
def test_a_module_beside_the_configuration_hides_none_of_a_library():
    Path("tensorboard.py").write_text("raise RuntimeError('not me')\n")
    Path("run.yaml").write_text("data: {task: PredatorPrey}\n")
    command = [Path(sys.executable).with_name("bra"), *FIT, "--config", Path("run.yaml").resolve()]
    Path("elsewhere").mkdir()
    done = subprocess.run(command, cwd="elsewhere", capture_output=True)
    assert done.returncode == 0, done.stderr
