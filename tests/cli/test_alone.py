"""Commands with a checkpoint and nothing else."""

import re
import sys
from pathlib import Path

import pytest

from bra import Agent
from bra.cli import main
from bra.objective import digits

TASK = "--data.task=PredatorPrey"
QUICK = [
    "--trainer.max_epochs=1",
    "--data.updates_per_epoch=3",
    "--data.batch_size=2",
    "--trainer.enable_progress_bar=false",
    "--behaviour=null",
]
RUN = Path("lightning_logs/version_0")
CHECKPOINT = f"--ckpt_path={RUN / 'checkpoints/last.ckpt'}"
BOX = "{class_path: Box, init_args: {low: -3, high: 3, shape: [2]}}"


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


@pytest.mark.parametrize(
    "task",
    [
        [TASK, "--model.beta_perception=8", "--model.percepts=5"],
        [TASK, "--model.replicas=2", "--model.beta_action=[1,10]"],
        ["--data.task=TargetTask", "--data.task.targets=[[1],[0]]", f"--model.percepts={BOX}"],
        ["--data.task=TableTask", "--data.task.utilities=[[1,-.inf,0.5],[0,3,0.5]]"],
    ],
)
def test_the_checkpoint_says_what_is_tested(capsys, task):
    main(["fit", *task, *QUICK, "--baseline=null"])
    agent = Agent.load_from_checkpoint(CHECKPOINT.split("=")[1])
    capsys.readouterr()
    main(["test", CHECKPOINT, "--trainer.enable_progress_bar=false"])
    shown = capsys.readouterr().out
    assert re.search(r"^(J|J, best of 4 agents) +-?\d", shown, re.MULTILINE) and "\nE[U]  " in shown
    terms = agent.evaluate()
    assert digits(terms.objective, terms.standard_error) in shown
    assert "Test metric" not in shown  # Lightning's table says the same
    main(["predict", CHECKPOINT, "--data.evaluation_worlds=5"])
    assert "5 rollouts" in capsys.readouterr().out


def test_classes_of_ones_own_need_the_configuration(capsys):
    Path("my_task_of_a_test.py").write_text(
        "from bra import TableTask\n\n\n"
        "class Mine(TableTask):\n"
        "    def __init__(self):\n"
        "        super().__init__([[1.0, 0.0], [0.0, 1.0]])\n"
    )
    sys.path.insert(0, str(Path.cwd()))
    main(["fit", "--data.task=my_task_of_a_test.Mine", *QUICK, "--baseline=null"])
    sys.path.pop(0)
    del sys.modules["my_task_of_a_test"]
    for path, said in (
        (RUN / "checkpoints/last.ckpt", "needs my_task_of_a_test.Mine, of a module that is not"),
        ("nowhere.ckpt", "ckpt_path: cannot read nowhere.ckpt: No such file"),
    ):
        with pytest.raises(SystemExit) as exit_:
            main(["test", f"--ckpt_path={path}"])
        line = capsys.readouterr().err.splitlines()[-1]
        assert exit_.value.code == 2 and line.startswith("error: ckpt_path") and said in line


def test_a_run_with_nothing_left_to_do_says_what_to_raise(capsys):
    main(["fit", TASK, *QUICK, "--baseline=null"])
    assert "nothing left" not in capsys.readouterr().out
    main(["fit", TASK, *QUICK, "--baseline=null", CHECKPOINT])
    line = capsys.readouterr().out.splitlines()[-1]
    assert line == ("nothing left to do: the checkpoint has 3 updates; raise trainer.max_epochs, 1")
    main(["fit", TASK, *QUICK, "--baseline=null", CHECKPOINT, "--trainer.max_epochs=2"])
    assert "nothing left" not in capsys.readouterr().out
