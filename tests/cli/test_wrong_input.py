"""Wrong input ends in one line."""

from pathlib import Path

import pytest
from commands import TARGETS, TASK, error_line


def test_a_channel_that_returns_no_distribution(tmp_path, capsys):
    (tmp_path / "my_mute_channel_of_a_test.py").write_text(
        "import bra\n\n\nclass Mute(bra.Channel):\n"
        "    def forward(self, condition):\n        return condition\n"
    )
    (tmp_path / "run.yaml").write_text(
        "data: {task: PredatorPrey}\nmodel: {perception: my_mute_channel_of_a_test.Mute}\n"
    )
    line = error_line(capsys, "fit", f"--config={tmp_path / 'run.yaml'}")
    assert line == (
        "error: perception: Mute.forward returned Tensor; "
        "expected a torch.distributions.Distribution"
    )


PROJECTION = ["--model.update_rule=Projection"]


EXPLOSIVE_RATE = "--model.perception_optimizer.lr=1e36"


@pytest.mark.parametrize(
    ("args", "parts"),
    [
        ([], ["a command is needed", "fit", "baseline", "outcomes"]),
        (["fit"], ["data.task"]),
        (["fti"], ["fti", "did you mean fit?", "baseline"]),
        (
            ["fit", "--data.task=PredatorPry"],
            ["data.task", "PredatorPry", "did you mean PredatorPrey?"],
        ),
        (
            ["fit", TASK, "--model.perception=MPL"],
            [
                "model.perception",
                "MPL",
                "did you mean MLP?",
                "expected one of CNN",
                "MLP, Multinomial",
            ],
        ),
        (
            ["fit", TASK, "--model.action=nope.Thing"],
            ["model.action", "nope.Thing", "cannot import"],
        ),
        (["fit", TASK, "--model.update_rule=ScoreFunktion"], ["did you mean ScoreFunction?"]),
        (["fit", TASK, "--model.persepts=3"], ["model.persepts", "did you mean model.percepts?"]),
        (
            ["fit", TASK, "--model.perception=MLP", "--model.perception.hiden=[3]"],
            ["model.perception", "hiden", "did you mean hidden?"],
        ),
        (
            ["fit", TASK, "--model.perception=MLP", "--model.perception.hidden=wide"],
            ["model.perception.hidden", "expected a list", "wide"],
        ),
        (
            ["fit", TASK, "--model.update_rule=ScoreFunction", "--model.update_rule.baseline=mean"],
            ["model.update_rule.baseline", "leave-one-out", "mean"],
        ),
        (["fit", TASK, "--model.action_scheduler=ExponentialLR"], ["action_scheduler", "gamma"]),
        (
            ["fit", TASK, "--model.cooling.factor=0"],
            ["cooling factor", "positive and finite", "got 0.0"],
        ),
        (["fit", TASK, "--model.cooling.facto=3"], ["facto", "did you mean factor?"]),
        (
            ["fit", TASK, "--model.action=Multinomial", "--model.action.start=cover"],
            ["model.action.start", "covering", "got cover"],
        ),
        (
            ["fit", TASK, *PROJECTION, "--model.update_rule.critic=TabelCritic"],
            ["model.update_rule.critic", "TabelCritic is no critic", "did you mean TableCritic?"],
        ),
        (
            ["fit", TASK, *PROJECTION, "--model.update_rule.exploration.share=2"],
            ["between 0 and 1, got 2.0"],
        ),
        (["fit", TASK, "--model.update_rule=Projektion"], ["did you mean Projection?"]),
        (
            [
                *("fit", "--data.task=TargetTask", TARGETS, "--model.action=Gaussian"),
                *PROJECTION,
                "--model.update_rule.critic=NetworkCritic",
            ],
            ["Projection needs actions that can be enumerated", "use ScoreFunction"],
        ),
        (["fit", TASK, "--seed_everything=-1"], ["seed_everything", "-1"]),
        (["fit", TASK, "--trainer.accumulate_grad_batches=2"], ["must be 1, got 2", "batch_size"]),
        (["fit", TASK, "--data.task.variant=fishing"], ["hunting", "mating", "fishing"]),
        (["fit", TASK, "--model.percepts=many"], ["model.percepts", "expected int", "many"]),
        (["fit", TASK, "--model.percepts=0"], ["percepts", "at least 1", "got 0"]),
        (["fit", TASK, "--data.batch_size=0"], ["batch_size", "at least 1", "got 0"]),
        (["fit", TASK, "--model.beta_action=-1"], ["beta_action", "positive and finite", "-1"]),
        (["fit", TASK, "--model.beta_action=nan"], ["beta_action", "nan"]),
        (["fit", TASK, "--model.beta_action=.inf"], ["beta_action", "inf"]),
        (["fit", TASK, "--model.perception=CNN"], ["CNN", "Box(0.0, 1.0, (4,)", "Discrete(9)"]),
        (["fit", TASK, "--information.every_n_updates=0"], ["every_n_updates", "at least 1"]),
        (["fit", "--config=/nope.yaml"], ["config", "/nope.yaml"]),
        (["fit", TASK, "--ckpt_path=/nope.ckpt"], ["ckpt_path", "/nope.ckpt"]),
        (
            ["fit", "--data.task=TableTask", "--data.task.utilities=/nope.csv"],
            ["/nope.csv", "No such file"],
        ),
        (
            ["fit", "--data.task=TableTask", "--data.task.utilities=[[1,.inf],[0,1]]"],
            ["utilities must be finite", "row 0, column 1"],
        ),
        (
            [
                "fit",
                "--data.task=TableTask",
                "--data.task.utilities=[[1,2],[0,1]]",
                "--data.task.prior=[0.5,0.6]",
            ],
            ["prior must sum to 1", "1.1"],
        ),
        (
            ["baseline", "--data.task=TargetTask", "--data.task.targets=[[1,1,1,1]]"],
            ["baseline needs", "TargetTask"],
        ),
        (
            ["fit", TASK, "--model.perception_optimizer=Adam", EXPLOSIVE_RATE],
            ["perception channel", "lower its learning rate"],
        ),
    ],
)
def test_wrong_input_is_one_line(args, parts, capsys):
    line = error_line(capsys, *args)
    for part in parts:
        assert part in line, line


def test_a_ragged_file_is_named_with_its_line(capsys, tmp_path):
    path = tmp_path / "ragged.csv"
    path.write_text("state,a,b\none,1,2\ntwo,3\n")
    line = error_line(capsys, "fit", "--data.task=TableTask", f"--data.task.utilities={path}")
    assert f"{path}, line 3: 1 value for 2 columns" in line


def test_a_checkpoint_of_another_task_is_refused(capsys, checkpoint):
    mating = [TASK, "--data.task.variant=mating", "--model.percepts=4"]
    line = error_line(capsys, "fit", *mating, f"--ckpt_path={checkpoint}")
    assert "the checkpoint has task PredatorPrey(variant=hunting" in line
    assert not Path("lightning_logs/version_1").exists()
