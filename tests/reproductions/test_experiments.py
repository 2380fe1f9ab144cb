"""Published training, done again."""

import csv
from pathlib import Path

import pytest
import yaml

from bra.cli import main
from bra.reproductions import EXPERIMENTS
from bra.reproductions.experiments import AGENTS, PAPER, RULES
from bra.reproductions.figures import COLOURS

CONFIGS = Path(__file__).parents[2] / "configs"
FILES = {
    "predator-prey-trained": ["predator_prey_online"],
    "mugs-trained": [f"nao_mugs_online/{name}" for name in ("high", "low_action", "low")],
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_protocol_is_that_of_the_configurations(name):
    experiment = EXPERIMENTS[name]
    population = experiment.population(PAPER, experiment.task())
    recipe = population.recipe
    for regime, file in zip(experiment.regimes, FILES[name], strict=True):
        text = (CONFIGS / f"{file}.yaml").read_text(encoding="utf-8")
        written = yaml.safe_load(text)
        model, data = written["model"], written["data"]
        assert regime.prices == (model["beta_perception"], model["beta_action"])
        for channel in ("perception", "action"):
            rate = getattr(regime, f"{channel}_rate")
            assert model[f"{channel}_optimizer"]["init_args"]["lr"] == rate
        assert model["perception"]["init_args"] == {"hidden": [experiment.hidden], "bias": False}
        assert model["percepts"] == experiment.percepts
        assert data["batch_size"] == 1
        assert data["updates_per_epoch"] * written["trainer"]["max_epochs"] == RULES[PAPER]
    assert recipe["update_rule"]["class_path"].endswith("ScoreFunction")
    assert recipe["action"]["class_path"].endswith("Multinomial")
    assert recipe["action"]["init_args"]["start"] is None
    assert [s.prices for s in population.settings[::AGENTS]] == [
        regime.prices for regime in experiment.regimes
    ]
    assert len(experiment.regimes) <= len(COLOURS)


@pytest.mark.parametrize(
    ("name", "figures"),
    [
        ("predator-prey-trained", ["learning"]),
        pytest.param("mugs-trained", ["development", "behaviour"], marks=pytest.mark.slow),
    ],
)
def test_both_rules_train_and_leave_figures_and_tables(
    name, figures, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("bra.reproductions.experiments.LOOKS", 10)
    for rule, updates in ((PAPER, 5), ("projection", 100)):
        monkeypatch.setitem(RULES, rule, updates)
    main(["reproduce", name, f"--folder={tmp_path}"])
    out = capsys.readouterr().out
    assert "5 updates by the paper's rule, then 100 updates by the projection" in out
    rows = {line[:50].strip(): line[50:].split() for line in out.splitlines()}
    for regime in EXPERIMENTS[name].regimes:
        reference, here, bound = map(float, rows[f"projection, {regime.name}: J"])
        assert reference - 0.005 * 5 <= here <= bound and here <= reference + 1e-5
        assert float(rows[f"{PAPER}, {regime.name}: J"][1]) < reference
        assert rows[f"projection, {regime.name}: at the optimum, of {AGENTS}"][1] == str(AGENTS)
    for run in ("version_0", "version_1"):
        folder = tmp_path / "lightning_logs" / run
        kinds = {f"{figure}.{kind}" for figure in figures for kind in ("png", "pdf")}
        assert {path.name for path in folder.iterdir()} == kinds | {"curves.csv", "population.csv"}
        assert all(path.stat().st_size > 1000 for path in folder.iterdir())
        with (folder / "population.csv").open(encoding="utf-8") as file:
            assert len(list(csv.DictReader(file))) == AGENTS * len(EXPERIMENTS[name].regimes)
