"""The command, called as a user calls it."""

import json
import re
import sys
from pathlib import Path

import pytest
import torch
import yaml
from commands import QUICK, SHORT, TASK, config, curves
from gymnasium.spaces import Box

from bra import Agent
from bra.cli import main

CURVES = {
    "objective/J",
    "objective/blahut_arimoto",
    "objective/upper_bound",
    "objective/gap",
    "objective/expected_utility",
    "information/perception_bits",
    "information/action_bits",
    "information/end_to_end_bits",
    "prices/beta_perception",
    "prices/beta_action",
}


FIGURES = {
    "behaviour/p_action_given_state",
    "behaviour/p_percept_given_state",
    "behaviour/p_action_given_percept",
}


def test_the_main_job_leaves_everything_behind(capsys):
    looks = ["--information.every_n_updates=5", "--behaviour.every_n_updates=10"]
    main(["fit", config("predator_prey.yaml"), *SHORT, *looks])
    folder = Path("lightning_logs/version_0")

    summary = json.loads((folder / "summary.json").read_text())
    assert summary["updates"] == 20
    assert summary["samples"] == 20
    assert summary["seed"] == 0
    assert summary["blahut_arimoto_objective"] == pytest.approx(3.27049, abs=1e-5)
    assert summary["upper_bound"] == pytest.approx(3.27475, abs=1e-5)
    assert summary["gap"] == summary["blahut_arimoto_objective"] - summary["objective"]
    agent = Agent.load_from_checkpoint(folder / "checkpoints" / "last.ckpt")
    assert agent.updates == 20
    reached = agent.evaluate()
    assert summary["objective"] == reached.objective
    assert summary["expected_utility"] == reached.expected_utility
    assert summary["perception_information_nats"] == reached.perception_information
    assert summary["action_information_nats"] == reached.action_information
    assert summary["end_to_end_information_nats"] == reached.end_to_end_information

    events = curves(folder)
    assert set(events.Tags()["scalars"]) >= CURVES
    assert set(events.Tags()["images"]) == FIGURES
    points = events.Scalars("objective/J")
    assert [point.step for point in points] == [0, 5, 10, 15, 20]
    assert points[-1].value == pytest.approx(reached.objective, abs=1e-6)
    assert [point.step for point in events.Scalars("objective/blahut_arimoto")] == [0, 20]
    gaps = events.Scalars("objective/gap")
    assert gaps[-1].value == pytest.approx(summary["gap"], abs=1e-6)
    assert "custom_scalars__config__" in events.Tags()["tensors"]

    printed = capsys.readouterr().out
    for text in ("optimum (Blahut-Arimoto)", "3.27049", "3.27475", "I(Ω;X) bits", "version_0"):
        assert text in printed


def test_a_run_resumes_from_its_last_checkpoint_and_its_saved_config():
    short = [TASK, *QUICK[1:], "--summary=null"]
    main(["fit", *short, "--trainer.max_epochs=2"])
    main(["fit", *short, "--trainer.max_epochs=1"])
    cut = Path("lightning_logs/version_1")
    saved, checkpoint = cut / "config.yaml", cut / "checkpoints/last.ckpt"
    longer = ["--trainer.max_epochs=2", "--behaviour=null"]
    main(["fit", f"--config={saved}", *longer, f"--ckpt_path={checkpoint}"])
    through, resumed = (
        Agent.load_from_checkpoint(f"lightning_logs/version_{run}/checkpoints/last.ckpt")
        for run in (0, 2)
    )
    assert resumed.updates == 20
    assert through.evaluate() == resumed.evaluate()


def test_schedules_of_each_channel():
    schedules = [
        *("--model.perception_scheduler=ExponentialLR", "--model.perception_scheduler.gamma=0.9"),
        *("--model.action_scheduler=StepLR", "--model.action_scheduler.step_size=10"),
    ]
    main(["fit", config("predator_prey.yaml"), *QUICK, *schedules])
    path = "lightning_logs/version_0/checkpoints/last.ckpt"
    rates = [s["_last_lr"][0] for s in torch.load(path, weights_only=True)["lr_schedulers"]]
    assert rates == pytest.approx([0.01 * 0.9**20, 0.05 * 0.1**2])


def test_monitors_can_be_turned_off_and_stay_so(capsys):
    off = [f"--{name}=null" for name in ("information", "baseline", "behaviour", "summary")]
    main(["fit", config("predator_prey.yaml"), *SHORT, *off])
    main(["fit", "--config=lightning_logs/version_0/config.yaml"])
    for run in range(2):
        folder = Path(f"lightning_logs/version_{run}")
        assert not (folder / "summary.json").exists()
        tags = curves(folder).Tags()
        assert not (CURVES | FIGURES) & {*tags["scalars"], *tags["images"]}
    assert "optimum" not in capsys.readouterr().out


def test_what_is_null_against_its_default_is_saved():
    ends = ["--trainer.max_epochs=null", "--trainer.max_steps=3", "--behaviour=null"]
    main(["fit", TASK, *QUICK, *ends])
    saved = yaml.safe_load(Path("lightning_logs/version_0/config.yaml").read_text())
    assert saved["trainer"]["max_epochs"] is None and saved["behaviour"] is None
    assert "max_time" not in saved["trainer"]


def test_percepts_can_be_a_space(monkeypatch):
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 64)
    space = "{class_path: Box, init_args: {low: -3, high: 3, shape: [2]}}"
    networks = ["--model.perception=MLP", "--model.action=MLP"]
    main(["fit", "--data.task=PredatorPrey", f"--model.percepts={space}", *networks, *QUICK])
    agent = Agent.load_from_checkpoint("lightning_logs/version_0/checkpoints/last.ckpt")
    assert agent.percept_space == Box(-3, 3, (2,))
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["gap"] is None
    assert summary["upper_bound"] == pytest.approx(2.33075, abs=1e-5)
    main(["validate", "--config=lightning_logs/version_0/config.yaml"])


def test_a_channel_and_a_table_beside_the_config(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "my_channel_of_a_test.py").write_text(
        "from torch import nn\n"
        "from torch.distributions import Categorical\n"
        "from bra import Channel\n\n\n"
        "class Noisy(Channel):\n"
        "    def __init__(self, condition_space, outcome_space, width: int = 8):\n"
        "        super().__init__(condition_space, outcome_space)\n"
        "        self.net = nn.Sequential(nn.LazyLinear(width), nn.ReLU(),\n"
        "                                 nn.Linear(width, int(outcome_space.n)))\n\n"
        "    def forward(self, condition):\n"
        "        return Categorical(logits=self.net(condition), validate_args=False)\n"
    )
    (folder / "utilities.csv").write_text("state,stay,flee\nmouse,3,1\nlion,0,5\n")
    (folder / "run.yaml").write_text(
        "data:\n"
        "  task:\n"
        "    class_path: TableTask\n"
        "    init_args: {utilities: utilities.csv, prior: [0.75, 0.25]}\n"
        "model:\n"
        "  perception:\n"
        "    class_path: my_channel_of_a_test.Noisy\n"
        "    init_args: {width: 5}\n"
        "  percepts: 2\n"
    )
    main(["fit", f"--config={folder / 'run.yaml'}", *QUICK])
    agent = Agent.load_from_checkpoint("lightning_logs/version_0/checkpoints/last.ckpt")
    assert agent.perception.net[0].weight.shape == (5, 2)
    assert agent.task.state_names == ("mouse", "lion")
    assert agent.task.prior.tolist() == [0.75, 0.25]

    sys.path.remove(str(folder))
    del sys.modules["my_channel_of_a_test"]
    path = "lightning_logs/version_0/checkpoints/last.ckpt"
    with pytest.raises(ValueError, match=r"my_channel_of_a_test\.Noisy, of a module that"):
        Agent.load_from_checkpoint(path)
    main(["validate", "--config=lightning_logs/version_0/config.yaml", f"--ckpt_path={path}"])


def test_a_checkpoint_imports_nothing(tmp_path, monkeypatch, checkpoint):
    (tmp_path / "evil_of_a_test.py").write_text("open('trace', 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    path, content = checkpoint, torch.load(checkpoint, weights_only=True)
    evil = {"class_path": "evil_of_a_test.Channel"}
    content["hyper_parameters"] = {"perception": evil}  # where Lightning looks for classes
    torch.save(content, path)
    main(["test", TASK, "--model.percepts=4", f"--ckpt_path={path}"])
    content["bra"]["recipe"]["perception"] = evil | {"init_args": {}, "factory": True}
    torch.save(content, path)
    with pytest.raises(SystemExit):
        main(["test", TASK, f"--ckpt_path={path}"])
    with pytest.raises(SystemExit):
        main(["rollout", f"--ckpt_path={path}"])
    assert not Path("trace").exists()
    with pytest.raises(SystemExit):
        main(["rollout", f"--ckpt_path={path}", "--trusted=[evil_of_a_test]"])
    assert Path("trace").exists()


def test_a_saved_configuration_names_public_paths():
    monitor = "--information=bra.callbacks.information.InformationMonitor"
    callback = ["--trainer.callbacks+=bra.callbacks.progress.UpdateBar"]
    main(["fit", "--data.task=bra.tasks.predator_prey.PredatorPrey", *QUICK, monitor, *callback])
    saved = Path("lightning_logs/version_0/config.yaml").read_text()
    paths = re.findall(r"class_path: (.+)", saved)
    assert {"bra.PredatorPrey", "bra.channels.MLP", "torch.optim.Adam"} <= {*paths}
    assert {f"bra.callbacks.{n}" for n in ("InformationMonitor", "UpdateBar")} <= {*paths}
    assert not re.search(r"class_path: bra\.\w+\.\w+\.", saved)


def newcomer(*more: str) -> list[str]:
    """A table of utilities and prices, and nothing else."""
    table = torch.rand(10, 10, generator=torch.Generator().manual_seed(10)).tolist()
    rows = [f"s{n},{','.join(map(str, row))}" for n, row in enumerate(table)]
    header = ",".join(["state", *(f"a{n}" for n in range(10))])
    Path("table.csv").write_text("\n".join([header, *rows]))
    prices = ["--model.beta_perception=20", "--model.beta_action=20"]
    return ["fit", "--data.task=TableTask", "--data.task.utilities=table.csv", *prices, *more]


def test_a_table_and_prices_are_enough(capsys):
    short = ["--trainer.max_epochs=2", "--data.updates_per_epoch=650", "--data.batch_size=1"]
    main(newcomer(*short, "--behaviour=null"))
    out = capsys.readouterr().out
    (line,) = (line for line in out.splitlines() if line.startswith("chosen for this task"))
    assert "percepts 10, update_rule Projection(rivals=Rivals)" in line
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["gap"] < 0.01
    assert "misses the optimum" not in out


def test_what_was_chosen_is_written_down(capsys):
    short = ["--trainer.max_epochs=1", "--data.updates_per_epoch=5"]
    main(newcomer(*short, "--behaviour=null"))
    assert "rivals settle after 1,200 updates; train longer" in capsys.readouterr().out
    main(["fit", "--config=lightning_logs/version_0/config.yaml", "--behaviour=null"])
    assert "chosen for this task" not in capsys.readouterr().out
    one, other = (Agent.load_from_checkpoint(path) for path in sorted(Path().rglob("last.ckpt")))
    assert one.recipe.keys() == other.recipe.keys()
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name])
