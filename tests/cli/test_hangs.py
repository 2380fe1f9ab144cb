"""Inputs that would never end, or that no memory holds."""

import os
import sys

import pytest

from bra.cli import main

TASK = "--data.task=PredatorPrey"
CSV = ["--data.task=TableTask", "--data.task.utilities"]

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--config=pipe"], "config: pipe is no file, but a folder, device or pipe"),
        (["--config=/dev/zero"], "config: /dev/zero is no file, but a folder, device or pipe"),
        ([*CSV, "pipe"], "pipe: it is a folder, device or pipe"),
        ([*CSV, "/dev/zero"], "cannot read utilities from /dev/zero"),
        ([*CSV, "pipe.npy"], "(a folder, device or pipe)"),
        (["--data.task=NaoMugs", "--data.task.robot=pipe"], "a robot from {here}/pipe: it is a fo"),
        ([TASK, "--ckpt_path=pipe"], "pipe is no whole checkpoint of a bra.Agent"),
        ([TASK, "--model.replicas=1000000000"], "1,000,000,000 agents would take more than"),
        ([TASK, "--data.batch_size=1000000000000"], "batch_size 1,000,000,000,000 would take"),
        ([TASK, "--data.evaluation_worlds=1000000000000"], "evaluation_worlds 1,000,000,000,000"),
        ([TASK, "--baseline.restarts=1000000000"], "1,000,000,000 restarts would take more than"),
        (
            [TASK, "--model.percepts=1000000000000"],
            "no memory holds this channel: one piece more",
        ),
        (
            [
                *(TASK, "--data.batch_size=1", "--model.update_rule=ScoreFunction"),
                f"--model.update_rule.samples={10**12}",
            ],
            "one piece more would take 7.28 TiB of memory, and there are",
        ),
    ],
)
def test_what_would_hang_is_refused(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    os.mkfifo("pipe")
    os.mkfifo("pipe.npy")
    with pytest.raises(SystemExit) as end:
        main(["fit", *words])
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert end.value.code == 2
    assert lines[-1].startswith("error: ") and said.format(here=tmp_path) in lines[-1]
