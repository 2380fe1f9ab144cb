"""The command, called as a user calls it."""

import csv
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import torch
from gymnasium.spaces import Box
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from bra import Agent
from bra.cli import main

CONFIGS = Path(__file__).parents[2] / "configs"
TASK = "--data.task=PredatorPrey"
TARGETS = "--data.task.targets=[[1]]"
QUICK = ["--trainer.max_epochs=2", "--data.updates_per_epoch=10"]
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


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


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


def curves(folder: Path) -> EventAccumulator:
    events = EventAccumulator(str(folder))
    events.Reload()
    return events


def test_the_main_job_leaves_everything_behind(capsys):
    main(["fit", config("predator_prey.yaml"), *QUICK, "--information.every_n_updates=5"])
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
    short = [config("predator_prey.yaml"), "--data.updates_per_epoch=10", "--summary=null"]
    main(["fit", *short, "--trainer.max_epochs=2"])
    main(["fit", *short, "--trainer.max_epochs=1"])
    cut = Path("lightning_logs/version_1")
    saved, checkpoint = cut / "config.yaml", cut / "checkpoints/last.ckpt"
    main(["fit", f"--config={saved}", "--trainer.max_epochs=2", f"--ckpt_path={checkpoint}"])
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
    main(["fit", config("predator_prey.yaml"), *QUICK, *schedules, "--behaviour=null"])
    path = "lightning_logs/version_0/checkpoints/last.ckpt"
    rates = [s["_last_lr"][0] for s in torch.load(path, weights_only=True)["lr_schedulers"]]
    assert rates == pytest.approx([0.01 * 0.9**20, 0.05 * 0.1**2])


def test_monitors_can_be_turned_off(capsys):
    off = [f"--{name}=null" for name in ("information", "baseline", "behaviour", "summary")]
    main(["fit", config("predator_prey.yaml"), *QUICK, *off])
    folder = Path("lightning_logs/version_0")
    assert not (folder / "summary.json").exists()
    tags = curves(folder).Tags()
    assert not (CURVES | FIGURES) & {*tags["scalars"], *tags["images"]}
    assert "optimum" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("overlay", "optimum"),
    [
        ("low_perception.yaml", 2.56010),
        ("low_action.yaml", 2.54754),
        ("low_both.yaml", 2.04489),
    ],
)
def test_overlays_change_the_prices(overlay, optimum):
    quick = [*QUICK, "--behaviour=null"]
    main(["fit", config("predator_prey.yaml"), config(f"prices/{overlay}"), *quick])
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["blahut_arimoto_objective"] == pytest.approx(optimum, abs=1e-5)


def test_the_papers_protocol():
    main(["fit", config("predator_prey_online.yaml"), *QUICK])
    agent = Agent.load_from_checkpoint("lightning_logs/version_0/checkpoints/last.ckpt")
    assert agent.samples == agent.updates == 20
    shapes = {name: tuple(p.shape) for name, p in agent.named_parameters()}
    assert shapes == {
        "perception.network.0.weight": (20, 4),
        "perception.network.2.weight": (13, 20),
        "action.eta": (8, 13),
    }
    rates = [optimizer.param_groups[0]["lr"] for optimizer in agent.configure_optimizers()[0]]
    assert rates == [0.006, 0.014]


def test_taken_actions_only():
    main(["fit", config("predator_prey_critic.yaml"), *QUICK, "--behaviour=null"])
    folder = Path("lightning_logs/version_0")
    agent = Agent.load_from_checkpoint(folder / "checkpoints" / "last.ckpt")
    assert agent.samples == agent.updates == agent.update_rule.critic.count.sum() == 20
    errors = [point.value for point in curves(folder).Scalars("critic/rmse")]
    assert errors[-1] == pytest.approx(agent.update_rule.critic.rmse)
    main(["validate", f"--config={folder / 'config.yaml'}"])  # what was saved can be read


@pytest.mark.slow
@pytest.mark.parametrize("name", ["predator_prey.yaml", "predator_prey_critic.yaml"])
@pytest.mark.parametrize("prices", [(8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0), (0.5, 0.5)])
def test_agents_reach_the_optimum(name, prices):
    betas = [f"--model.beta_{k}={b}" for k, b in zip(("perception", "action"), prices, strict=True)]
    main(["fit", config(name), *betas, "--behaviour=null"])
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert -1e-6 < summary["gap"] < 0.005
    assert summary["samples"] <= 20_000


MUG_EXPERIMENTS = [
    ("nao_mugs_high.yaml", 3.85000),
    ("nao_mugs_low_action.yaml", 2.78565),
    ("nao_mugs_low.yaml", 2.75000),
    ("nao_mugs_jitter.yaml", 3.85000),
    ("nao_mugs_cnn.yaml", 3.85000),
    ("nao_mugs_critic.yaml", 3.85000),
    ("nao_mugs_specialists.yaml", 4.04778),
    ("nao_mugs_online/high.yaml", 3.85000),
    ("nao_mugs_online/low_action.yaml", 2.78565),
    ("nao_mugs_online/low.yaml", 2.75000),
]


@pytest.mark.parametrize(("name", "optimum"), MUG_EXPERIMENTS)
def test_mug_experiments(name, optimum):
    still = ("high.yaml", "low_action.yaml", "low.yaml")
    few = [] if name.endswith(still) else ["--data.task.bank=4"]
    main(["fit", config(name), *QUICK, *few, "--behaviour=null", "--frames=null"])
    folder = Path("lightning_logs/version_0")
    summary = json.loads((folder / "summary.json").read_text())
    key = "objective_without_sensor_noise" if few else "blahut_arimoto_objective"
    assert summary[key] == pytest.approx(optimum, abs=1e-5)
    assert summary["note"].startswith("no optimum: a signal is 192 numbers") is bool(few)
    assert (summary["state_information_nats"] is None) is not bool(few)
    agent = Agent.load_from_checkpoint(folder / "checkpoints" / "last.ckpt")
    assert agent.task.observation_space.shape == (1, 12, 16)
    assert agent.evaluate().objective == summary["objective"]
    if name not in ("nao_mugs_cnn.yaml", "nao_mugs_specialists.yaml"):  # 192–4–4, without bias
        shapes = [tuple(parameter.shape) for parameter in agent.perception.parameters()]
        assert shapes == [(4, 192), (4, 4)]


def test_every_config_is_run_here():
    names = {str(path.relative_to(CONFIGS)) for path in CONFIGS.rglob("*.yaml")}
    assert names == {
        *(name for name, _ in MUG_EXPERIMENTS),
        "medical.yaml",
        "predator_prey.yaml",
        "predator_prey_critic.yaml",
        "predator_prey_online.yaml",
        "prices/low_perception.yaml",
        "prices/low_action.yaml",
        "prices/low_both.yaml",
    }


def test_specialists_are_trained_from_their_config():
    main(["fit", config("medical.yaml"), *QUICK, "--baseline.restarts=1"])
    run = Path("lightning_logs/version_0")
    summary = json.loads((run / "summary.json").read_text())
    assert 0 < summary["direct_information_nats"] < 1
    assert summary["blahut_arimoto_objective"] <= 2.406736
    assert summary["upper_bound"] == pytest.approx(2.416928, abs=1e-5)
    assert summary["bound"] == summary["upper_bound"]
    events = EventAccumulator(str(run)).Reload()
    tags = events.Tags()
    assert {"information/direct_bits", "flow/with_direct_bits", "optimum/direct_bits"} <= {
        *tags["scalars"]
    }
    assert "behaviour/p_action_given_percept_and_state" in tags["images"]


def test_what_a_frontier_cannot_do_with_three_prices(capsys):
    agents = [config("medical.yaml"), "--agents"]
    assert "trains agents of two prices" in error_line(capsys, "frontier", *agents)


def test_percepts_can_be_a_space():
    space = "{class_path: Box, init_args: {low: -3, high: 3, shape: [2]}}"
    networks = ["--model.perception=MLP", "--model.action=MLP"]
    main(["fit", "--data.task=PredatorPrey", f"--model.percepts={space}", *networks, *QUICK])
    agent = Agent.load_from_checkpoint("lightning_logs/version_0/checkpoints/last.ckpt")
    assert agent.percept_space == Box(-3, 3, (2,))
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["gap"] is None
    assert summary["upper_bound"] == pytest.approx(2.33075, abs=1e-5)
    main(["validate", "--config=lightning_logs/version_0/config.yaml"])


def test_export_writes_tidy_tables_of_agent_and_optimum(capsys):
    main(["fit", TASK, "--model.percepts=4", *QUICK])
    (checkpoint,) = Path().rglob("last.ckpt")
    main(["export", f"--ckpt_path={checkpoint}"])
    agent, folder = Agent.load_from_checkpoint(checkpoint), Path("lightning_logs/version_0/export")
    tables = {}
    for path in folder.iterdir():
        with path.open(encoding="utf-8") as file:
            tables[path.stem] = list(csv.DictReader(file))
    assert {row["source"] for row in tables["percept_marginal"]} == {"agent", "optimum"}
    rows = [row for row in tables["action_given_state"] if row["source"] == "agent"]
    expected = agent.evaluation().action_given_state.flatten().tolist()
    assert [float(row["probability"]) for row in rows] == pytest.approx(expected, abs=1e-12)
    names = [[row["state"], row["action"]] for row in rows[:2]]
    assert names == [[agent.task.state_names[0], name] for name in agent.task.action_names[:2]]
    for name, given in (("percept_given_state", "state"), ("action_given_percept", "percept")):
        sums = Counter()
        for row in tables[name]:
            sums[row["source"], row[given]] += float(row["probability"])
        assert list(sums.values()) == pytest.approx([1.0] * len(sums))
    main(["fit", "--data.task=TargetTask", TARGETS, "--model.percepts=2", *QUICK])
    (checkpoint,) = Path("lightning_logs/version_1").rglob("last.ckpt")
    line = error_line(capsys, "export", f"--ckpt_path={checkpoint}")
    assert "export writes tables of finitely many" in line and "TargetTask" in line
    assert "cannot read nowhere.ckpt" in error_line(capsys, "export", "--ckpt_path=nowhere.ckpt")


def test_frontier_writes_a_table_and_figures(capsys):
    Path("table.csv").write_text("state,stay,flee\nmouse,3,1\nlion,0,5\n")
    task = ["--data.task=TableTask", "--data.task.utilities=table.csv"]
    short = ["--points=3", "--agents", "--trainer.max_epochs=1", "--data.updates_per_epoch=10"]
    main(["frontier", *task, *short])
    out = capsys.readouterr().out
    assert "information becomes worth its price: 2 percepts" in out
    folder = Path("lightning_logs/version_0")
    with (folder / "frontier.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert Counter(row["kind"] for row in rows) == {"optimum": 5, "agent": 5}
    assert all(float(row["perception_information_bits"]) >= 0 for row in rows)
    assert (folder / "frontier.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "frontier.pdf").read_bytes().startswith(b"%PDF")
    Path("frontier.csv").write_text("mine")
    main(["frontier", *task, "--points=2", "--trainer.logger=false"])
    assert "lightning_logs/version_1/frontier.csv" in capsys.readouterr().out
    assert Path("frontier.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--data.task=TargetTask", TARGETS, "--model.action=Gaussian"], "frontier needs a task"),
        ([TASK, "--model.beta_action=[1,2]"], "frontier scales one pair of prices"),
        ([TASK, "--points=0"], "points must be a whole number of at least 1, got 0"),
    ],
)
def test_what_has_no_frontier_is_said_in_one_line(capsys, args, words):
    assert words in error_line(capsys, "frontier", *args)


@pytest.mark.parametrize("budget", [(), ("--model.perception_bits=0.5",)], ids=["prices", "bits"])
def test_baseline_takes_the_restarts_of_the_monitor(budget, capsys, monkeypatch):
    asked = []
    for place in ("bra.cli.baseline.solve_all_references", "bra.cli.baseline.serial"):
        monkeypatch.setattr(place, lambda *args, **_: sys.exit(asked.append(args)))
    price = () if budget else ("--model.beta_perception=8",)
    task = ("--data.task=PredatorPrey", *price, "--model.beta_action=10", *budget)
    with pytest.raises(SystemExit):
        main(["baseline", *task, "--baseline.restarts=7", "--baseline.certify=3"])
    assert 7 in [value for value in asked[0] if isinstance(value, int)]


def test_baseline_prints_the_optimum(capsys):
    main(["baseline", config("predator_prey.yaml")])
    assert "3.27049" in capsys.readouterr().out
    main(["baseline", config("predator_prey.yaml"), "--json"])
    optimum = json.loads(capsys.readouterr().out)
    assert optimum["objective"] == pytest.approx(3.27049, abs=1e-5)
    assert optimum["upper_bound"] == pytest.approx(3.27475, abs=1e-5)
    assert len(optimum["optima"]) == 32
    assert optimum["converged"] is True
    assert not Path("lightning_logs").exists()


def test_baselines_of_several_prices_have_the_third(capsys):
    prices = ["--model.beta_perception=[8,10]", "--model.beta_direct=0.9"]
    main(["baseline", config("medical.yaml"), *prices, "--baseline.restarts=2", "--json"])
    assert [o["beta_direct"] for o in json.loads(capsys.readouterr().out)] == [0.9, 0.9]


def test_validate_test_and_predict_use_a_checkpoint(capsys):
    main(["fit", config("predator_prey.yaml"), *QUICK, "--summary=null"])
    checkpoint = "--ckpt_path=lightning_logs/version_0/checkpoints/last.ckpt"
    reached = Agent.load_from_checkpoint(checkpoint.split("=")[1]).evaluate().objective
    capsys.readouterr()
    for command, shown in (("validate", str(reached)[:7]), ("test", f"{reached:.5f}")):
        main([command, config("predator_prey.yaml"), checkpoint])
        assert shown in capsys.readouterr().out
    main(["predict", config("predator_prey.yaml"), checkpoint, "--data.evaluation_worlds=5"])
    path = Path(re.search(r"5 rollouts in (\S+)", capsys.readouterr().out).group(1))
    header, *rows = path.read_text().splitlines()
    assert header == "state,percept,action,utility"
    assert len(rows) == 5
    assert all(row.startswith("size ") for row in rows)


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


def test_a_checkpoint_imports_nothing(tmp_path, monkeypatch):
    (tmp_path / "evil_of_a_test.py").write_text("open('trace', 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    main(["fit", TASK, *QUICK, "--summary=null", "--behaviour=null"])
    path = Path("lightning_logs/version_0/checkpoints/last.ckpt")
    checkpoint = torch.load(path, weights_only=True)
    evil = {"class_path": "evil_of_a_test.Channel"}
    checkpoint["hyper_parameters"] = {"perception": evil}  # where Lightning looks for classes
    torch.save(checkpoint, path)
    main(["test", TASK, f"--ckpt_path={path}"])
    checkpoint["bra"]["recipe"]["perception"] = evil | {"init_args": {}, "factory": True}
    torch.save(checkpoint, path)
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


def newcomer(*more: str) -> list[str]:
    """A table of utilities and prices, and nothing else."""
    table = torch.rand(10, 10, generator=torch.Generator().manual_seed(10)).tolist()
    rows = [f"s{n},{','.join(map(str, row))}" for n, row in enumerate(table)]
    header = ",".join(["state", *(f"a{n}" for n in range(10))])
    Path("table.csv").write_text("\n".join([header, *rows]))
    prices = ["--model.beta_perception=20", "--model.beta_action=20"]
    return ["fit", "--data.task=TableTask", "--data.task.utilities=table.csv", *prices, *more]


def test_a_table_and_prices_are_enough(capsys):
    main(newcomer("--trainer.max_epochs=2", "--data.batch_size=1", "--behaviour=null"))
    out = capsys.readouterr().out
    (line,) = (line for line in out.splitlines() if line.startswith("chosen for this task"))
    assert "percepts 10, update_rule Projection(rivals=Rivals)" in line
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["gap"] < 0.01
    assert "misses the optimum" not in out


def test_what_was_chosen_is_written_down(capsys):
    short = ["--trainer.max_epochs=1", "--data.updates_per_epoch=5"]
    main(newcomer(*short))
    assert "rivals settle after 1,200 updates; train longer" in capsys.readouterr().out
    main(["fit", "--config=lightning_logs/version_0/config.yaml"])
    assert "chosen for this task" not in capsys.readouterr().out
    one, other = (Agent.load_from_checkpoint(path) for path in sorted(Path().rglob("last.ckpt")))
    assert one.recipe.keys() == other.recipe.keys()
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name])


@pytest.mark.parametrize("way", ["chosen", "given"])
def test_shares_of_the_run_are_written_down_as_updates(way, capsys):
    target = ["--data.task=TargetTask", "--data.task.targets=[[0],[1]]"]
    given = ["--model.cooling.factor=2", "--model.cooling.updates=0.4"] if way == "given" else []
    main(["fit", *target, *QUICK, *given, "--trainer.max_steps=15"])
    assert ("cooling Cooling(factor=4.0, updates=6)" in capsys.readouterr().out) is not bool(given)
    folder = Path("lightning_logs/version_0")
    line = re.compile(r"  cooling:\n(.*\n){1,3} +updates: 6\n")
    assert line.search((folder / "config.yaml").read_text())
    longer = [f"--ckpt_path={folder / 'checkpoints/last.ckpt'}", *QUICK]
    main(["fit", *target, *given, *longer])
    assert line.search(Path("lightning_logs/version_1/config.yaml").read_text())


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


def test_a_checkpoint_of_another_task_is_refused(capsys):
    main(["fit", TASK, *QUICK, "--summary=null", "--behaviour=null"])
    checkpoint = "--ckpt_path=lightning_logs/version_0/checkpoints/last.ckpt"
    line = error_line(capsys, "fit", TASK, "--data.task.variant=mating", checkpoint)
    assert "the checkpoint has task PredatorPrey(variant=hunting" in line
    assert not Path("lightning_logs/version_1").exists()


def test_the_documents_are_finished():
    for path in [*CONFIGS.parent.glob("*.md"), *CONFIGS.parent.glob("docs/*.md")]:
        assert "@@" not in path.read_text(), path


def run(*args):
    command = [sys.executable, "-X", "importtime", "-m", "bra", *args]
    return subprocess.run(command, capture_output=True, text=True)


def test_help_is_there():
    shown = run("fit", "--help")
    for text in ("--model.perception", "--data.task", "--information", "Inverse price", "β₁"):
        assert text.lower() in shown.stdout.lower()
    first, _, _ = shown.stderr.partition("| torch\n")
    assert "\nbra fit: loading torch …\n" in first  # said before the seconds pass


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (
            ["--help"],
            0,
            "fit validate test predict baseline frontier export reproduce rollout outcomes help",
        ),
        (
            ["-h"],
            0,
            "fit validate test predict baseline frontier export reproduce rollout outcomes help",
        ),
        (["--version"], 0, "bra 0."),
        ([], 2, "command needed"),
        (["fti"], 2, "did you mean fit?"),
        (["fit", "--config", "nowhere.yaml"], 2, "config: cannot read nowhere.yaml: No such file"),
        (["fit", "--config=tabs.yaml"], 2, "config: tabs.yaml, line 2, is no YAML"),
        (["fit", "--config=list.yaml"], 2, "config: list.yaml must hold sections"),
        (["fit", "--config=latin.yaml"], 2, "config: cannot read latin.yaml: not UTF-8"),
        (["fit", "--config"], 2, "--config needs a file"),
        (["fit", "--config=."], 2, "config: . is no file, but a folder, device or pipe"),
    ],
)
def test_what_needs_no_torch_loads_none(args, code, words):
    Path("tabs.yaml").write_text("data:\n\ttask: PredatorPrey\n")
    Path("list.yaml").write_text("[data, model]\n")
    Path("latin.yaml").write_bytes("data: {task: Jäger}\n".encode("latin-1"))
    done = run(*args)
    assert done.returncode == code
    assert not re.search(r"\| +(torch|numpy|lightning)\b", done.stderr)
    said = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    assert len(said) == (code == 2)
    for word in words.split():
        assert word in done.stdout + "".join(said)
