"""Commands with a checkpoint and nothing else."""

import re
import sys
from pathlib import Path

import pytest
from training import fit

from bra import Agent, TableTask
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


@pytest.mark.parametrize(
    "task",
    [
        [TASK, "--model.beta_perception=8", "--model.percepts=5"],
        [TASK, "--model.replicas=2", "--model.beta_action=[1,10]"],
        ["--data.task=TargetTask", "--data.task.targets=[[1],[0]]", f"--model.percepts={BOX}"],
        ["--data.task=TableTask", "--data.task.utilities=[[1,-.inf,0.5],[0,3,0.5]]"],
    ],
)
def test_the_checkpoint_says_what_is_tested(capsys, monkeypatch, task):
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 64)
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
    needs = "ckpt_path: the checkpoint needs my_task_of_a_test.Mine, of a module that is not loaded"
    trust = "if you trust its code, add --trusted my_task_of_a_test"
    config = Path.cwd() / RUN / "config.yaml"
    assert refused(capsys, "test", CHECKPOINT) == f"{needs}; give --config {config}, or, {trust}"
    assert refused(capsys, "export", CHECKPOINT) == f"{needs}; {trust}"
    for command, *way in (
        ("test", f"--config={config}"),
        ("export", "--trusted", "my_task_of_a_test"),
        ("validate", "--trusted=[my_task_of_a_test]"),
    ):
        main([command, CHECKPOINT, *way])
        del sys.modules["my_task_of_a_test"]
        sys.path[:] = [folder for folder in sys.path if folder != str(Path.cwd())]
    assert str(Path.cwd()) in Path("lightning_logs/version_2/config.yaml").read_text()


def test_a_checkpoint_that_is_not_there(capsys):
    said = "ckpt_path: cannot read nowhere.ckpt: No such file or directory"
    assert refused(capsys, "test", "--ckpt_path=nowhere.ckpt") == said


def test_classes_of_a_script_stay_there(capsys, monkeypatch):
    class Mine(TableTask):
        pass

    Mine.__module__, Mine.__qualname__ = "__main__", "Mine"
    monkeypatch.setattr(sys.modules["__main__"], "Mine", Mine, raising=False)
    fit(Agent(Mine([[1.0, 0.0]]), seed=0), Path(), max_steps=1).save_checkpoint("mine.ckpt")
    monkeypatch.delattr(sys.modules["__main__"], "Mine")
    for command in ("predict", "export"):
        line = refused(capsys, command, "--ckpt_path=mine.ckpt", "--trusted=__main__")
        assert "the checkpoint needs Mine, a class of the script that trained it; load it" in line


def refused(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main([*words])
    assert end.value.code == 2
    return capsys.readouterr().err.splitlines()[-1].removeprefix("error: ")


def test_a_run_with_nothing_left_to_do_says_what_to_raise(capsys):
    main(["fit", TASK, *QUICK, "--baseline=null"])
    assert "nothing left" not in capsys.readouterr().out
    main(["fit", TASK, *QUICK, "--baseline=null", CHECKPOINT])
    line = capsys.readouterr().out.splitlines()[-1]
    assert line == ("nothing left to do: the checkpoint has 3 updates; raise trainer.max_epochs, 1")
    main(["fit", TASK, *QUICK, "--baseline=null", CHECKPOINT, "--trainer.max_epochs=2"])
    assert "nothing left" not in capsys.readouterr().out
