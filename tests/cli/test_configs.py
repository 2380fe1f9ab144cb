"""The project's configurations train."""

import json
import re
from pathlib import Path

import pytest
from commands import CONFIGS, QUICK, SHORT, config, curves
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from bra import Agent
from bra.cli import main


@pytest.mark.parametrize(
    ("overlay", "optimum"),
    [
        ("low_perception.yaml", 2.56010),
        ("low_action.yaml", 2.54754),
        ("low_both.yaml", 2.04489),
    ],
)
def test_overlays_change_the_prices(overlay, optimum):
    main(["fit", config("predator_prey.yaml"), config(f"prices/{overlay}"), *QUICK])
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
    main(["fit", config("predator_prey_critic.yaml"), *QUICK])
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
def test_mug_experiments(name, optimum, monkeypatch):
    monkeypatch.setattr("bra.evaluation.worlds.EVALUATION_WORLDS", 256)
    still = ("high.yaml", "low_action.yaml", "low.yaml")
    few = [] if name.endswith(still) else ["--data.task.bank=4", "--data.evaluation_worlds=64"]
    main(["fit", config(name), *QUICK, *few, "--frames=null"])
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
    own = ["--baseline.restarts=1", "--behaviour.every_n_updates=20"]
    main(["fit", config("medical.yaml"), *SHORT, *own])
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


def test_the_documents_are_finished():
    for path in [*CONFIGS.parent.glob("*.md"), *CONFIGS.parent.glob("docs/*.md")]:
        assert "@@" not in path.read_text(), path
