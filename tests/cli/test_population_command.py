"""Populations from the command, with all that they leave behind."""

import csv
import json
from pathlib import Path

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from bra import Agent, Population
from bra.cli import main

FOLDER = Path("lightning_logs/version_0")
ARGS = [
    "--data.task=PredatorPrey",
    "--model.percepts=5",
    "--model.update_rule=Projection",
    "--model.action=Multinomial",
    "--model.action.start=covering",
    "--data.updates_per_epoch=20",
    "--data.batch_size=4",
    "--trainer.max_epochs=1",
    "--behaviour=null",
]
OPTIMA = {(8.0, 10.0): 3.27049, (1.0, 10.0): 2.56010}


def error_line(capsys, *args: str) -> str:
    with pytest.raises(SystemExit) as exit_:
        main(list(args))
    assert exit_.value.code == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_lists_and_replicas_make_a_population(capsys):
    main(
        [
            *("fit", *ARGS, "--model.percepts=13", "--model.replicas=3"),
            *("--model.beta_perception=[1,8]", "--model.beta_action=10"),
            *("--model.perception_rate=[0.003,0.01]", "--population.every_n_updates=10"),
        ]
    )
    printed = capsys.readouterr().out
    population = Population.load_from_checkpoint(FOLDER / "checkpoints/last.ckpt")
    assert [(s.seed, *s.prices, s.perception_rate) for s in population.settings] == [
        *((seed, 1.0, 10.0, 0.003) for seed in range(3)),
        *((seed, 8.0, 10.0, 0.01) for seed in range(3)),
    ]
    objectives = population.objectives()

    with (FOLDER / "population.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["objective"]) for row in rows] == objectives.tolist()
    for row in rows:
        optimum = OPTIMA[float(row["beta_perception"]), float(row["beta_action"])]
        assert float(row["gap"]) + float(row["objective"]) == pytest.approx(optimum, abs=1e-4)
    assert [row["seed"] for row in rows] == ["0", "1", "2"] * 2
    assert rows[0]["action_rate"] == ""

    summary = json.loads((FOLDER / "summary.json").read_text())
    best = population.best_agent()
    assert summary["replicas"] == 6
    assert summary["objective"] == pytest.approx(objectives.max().item(), abs=1e-6)
    assert summary["objective_median"] == pytest.approx(objectives.quantile(0.5).item())
    assert summary["objective_min"] == objectives.min().item()
    assert summary["hit_threshold"] == 0.005 * population.task.utility_range == 0.025
    hits = sum(float(row["gap"]) <= 0.025 for row in rows) / 6
    assert summary["hit_rate"] == pytest.approx(hits)
    assert summary["hit_rate_low"] < hits < summary["hit_rate_high"] or hits in (0, 1)
    assert [row["agents"] for row in summary["prices"]] == [3, 3]
    for row in summary["prices"]:
        pair = row["beta_perception"], row["beta_action"]
        own = [r for r in rows if float(r["beta_perception"]) == pair[0]]
        assert row["blahut_arimoto_objective"] == pytest.approx(OPTIMA[pair], abs=1e-4)
        assert row["objective_best"] == max(float(r["objective"]) for r in own)
        assert row["hit_rate"] == pytest.approx(sum(float(r["gap"]) <= 0.025 for r in own) / 3)
        assert f"β₁ {pair[0]:g}, β₂ {pair[1]:g}" in printed
    assert summary["seed"] == best.seed
    assert summary["blahut_arimoto_objective"] == pytest.approx(
        OPTIMA[best.beta_perception, best.beta_action], abs=1e-4
    )
    for text in ("J, best of 6 agents", "median", "at the optimum", "up to a gap of 0.025"):
        assert text in printed

    events = EventAccumulator(str(FOLDER))
    events.Reload()
    for name, value in {
        "J_best": objectives.max(),
        "J_median": objectives.quantile(0.5),
        "J_min": objectives.min(),
        "hit_rate": hits,
    }.items():
        points = events.Scalars(f"population/{name}")
        assert [point.step for point in points] == [0, 10, 20]
        assert points[-1].value == pytest.approx(float(value), abs=1e-6)
    assert events.Scalars("objective/J")[-1].value == pytest.approx(summary["objective"], abs=1e-6)


def test_the_saved_configuration_goes_on_from_the_checkpoint():
    population = ["--model.replicas=2", "--model.action_rate=[0.01,0.1]", "--model.grid=true"]
    main(["fit", *ARGS, *population, "--trainer.max_epochs=2", "--summary=null"])
    main(["fit", *ARGS, *population, "--summary=null"])
    cut = Path("lightning_logs/version_1")
    resume = [f"--config={cut / 'config.yaml'}", f"--ckpt_path={cut / 'checkpoints/last.ckpt'}"]
    main(["fit", *resume, "--trainer.max_epochs=2", "--behaviour=null"])
    through, resumed = (
        Population.load_from_checkpoint(f"lightning_logs/version_{run}/checkpoints/last.ckpt")
        for run in (0, 2)
    )
    assert resumed.updates == 40
    for name, tensor in through.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name])


def test_a_population_is_tested_by_its_best_agent(capsys):
    main(["fit", *ARGS, "--model.replicas=3"])
    checkpoint = FOLDER / "checkpoints/last.ckpt"
    best = Agent.load_from_checkpoint(checkpoint)
    saved = [f"--config={FOLDER / 'config.yaml'}", f"--ckpt_path={checkpoint}"]
    capsys.readouterr()
    for command in ("validate", "test"):
        main([command, *saved])
        assert str(best.evaluate().objective)[:6] in capsys.readouterr().out
    main(["predict", *saved, "--data.evaluation_worlds=5"])
    assert "5 rollouts" in capsys.readouterr().out
    main(["baseline", f"--config={FOLDER / 'config.yaml'}"])
    assert "upper bound" in capsys.readouterr().out


def test_one_agent_remains_one_agent():
    main(["fit", *ARGS, "--model.perception_rate=0.5"])
    agent = Agent.load_from_checkpoint(FOLDER / "checkpoints/last.ckpt")
    with pytest.raises(ValueError, match="holds one agent"):
        Population.load_from_checkpoint(FOLDER / "checkpoints/last.ckpt")
    assert agent.configure_optimizers()[0][0].param_groups[0]["lr"] == 0.5
    summary = json.loads((FOLDER / "summary.json").read_text())
    assert (summary["replicas"], summary["hit_rate"], summary["objective_median"]) == (
        1,
        None,
        None,
    )
    assert not (FOLDER / "population.csv").exists()


@pytest.mark.parametrize(
    ("args", "parts"),
    [
        (["--model.replicas=0"], ["replicas", "at least 1", "got 0"]),
        (["--model.replicas=many"], ["model.replicas", "expected int", "many"]),
        (["--model.replicates=2"], ["model.replicates", "did you mean model.replicas?"]),
        (
            ["--model.beta_perception=[1,2]", "--model.action_rate=[0.1,0.2,0.3]"],
            ["beta_perception has 2, action_rate has 3", "grid=true"],
        ),
        (["--model.beta_perception=[1,-2]"], ["beta_perception", "positive and finite", "-2"]),
        (["--model.beta_perception=[1,x]"], ["model.beta_perception", "x"]),
        (
            ["--model.replicas=2", "--model.perception_optimizer=Adafactor"],
            ["perception_optimizer", "Adafactor does not treat each parameter by itself"],
        ),
    ],
)
def test_wrong_input_is_one_line(args, parts, capsys):
    line = error_line(capsys, "fit", *ARGS, *args)
    assert line.startswith("error: ")
    for part in parts:
        assert part in line, line


def test_curves_have_a_row_per_agent_and_look_and_go_on(capsys):
    looks = ["--population.every_n_updates=2", "--data.updates_per_epoch=4"]
    args = [*ARGS, *looks, "--model.replicas=2", "--model.beta_action=[1,10]", "--baseline=null"]
    main(["fit", *args, "--trainer.max_epochs=2"])
    straight = (FOLDER / "curves.csv").read_text()
    rows = list(csv.DictReader(straight.splitlines()))
    updates = ["0", "2", "4", "6", "8"]
    assert [row["updates"] for row in rows] == [u for u in updates for _ in range(4)]
    assert [row["agent"] for row in rows[:4]] == ["0", "1", "2", "3"]
    last = next(csv.DictReader((FOLDER / "population.csv").open()))
    assert rows[-4]["objective"] == last["objective"] and rows[-4]["gap"] == ""

    main(["fit", *args, "--trainer.max_epochs=1"])
    half = FOLDER.with_name("version_1")
    assert (half / "curves.csv").read_text() == straight[: straight.index("\n6,") + 1]
    checkpoint = f"--ckpt_path={half / 'checkpoints/last.ckpt'}"
    main(["fit", *args, "--trainer.max_epochs=2", checkpoint])
    assert FOLDER.with_name("version_2").joinpath("curves.csv").read_text() == straight


def test_a_baseline_at_lists_of_prices_has_a_row_for_each_pair(capsys):
    lists = [*ARGS[:1], "--model.beta_perception=[1,8]", "--model.beta_action=[1,10]"]
    main(["baseline", *lists])
    head, *rows, foot = capsys.readouterr().out.splitlines()
    assert head.split()[:4] == ["β₁", "β₂", "J", "bound"] and "bits" in foot
    assert [row.split()[:2] for row in rows] == [["1", "1"], ["8", "10"]]
    main(["baseline", *lists, "--model.grid=true", "--json"])
    optima = json.loads(capsys.readouterr().out)
    prices = [(optimum["beta_perception"], optimum["beta_action"]) for optimum in optima]
    assert prices == [(1, 1), (1, 10), (8, 1), (8, 10)]
    assert f"{optima[3]['objective']:.5f}" == rows[1].split()[2]
    line = error_line(capsys, "baseline", *lists, "--certify=1")
    assert line == "error: certify takes one pair of prices, got 2; solve for each alone"
