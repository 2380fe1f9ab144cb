"""Prices of many agents, each of which follow their own budgets."""

import csv
import json
import math
import sys
from functools import partial
from pathlib import Path

import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from torch.optim import Adam
from training import UPDATES_PER_EPOCH, assert_same_state, fit, make_trainer

from bra import Agent, Cooling, Population, RolloutDataModule, TableTask
from bra.blahut_arimoto import serial
from bra.channels import MLP, Multinomial
from bra.cli import main
from bra.update_rules import Projection, ScoreFunction

LN2 = math.log(2)
CHOICE = TableTask([[1.0, 0.0], [0.0, 1.0]])
PARTS = {
    "perception": partial(MLP, hidden=[6]),
    "action": partial(Multinomial, start="covering"),
    "percepts": 2,
    "update_rule": Projection(),
    "perception_optimizer": partial(Adam, lr=0.05),
    "action_optimizer": partial(Adam, lr=0.1),
    "seed": 3,
}
BUDGETS = {"perception_bits": [0.3, 0.6], "action_bits": 0.4}


@pytest.fixture
def double():
    """Float64, so that rounding tips no draw."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def make(replicas=2, **own):
    return Population(CHOICE, replicas, **(PARTS | own))


def test_every_member_comes_to_the_budgets(tmp_path):
    population = make(3, perception_bits=0.6, action_bits=0.4)
    assert population.beta_perception.tolist() == [20.0] * 3
    make_trainer(tmp_path, max_epochs=1).fit(population, RolloutDataModule(CHOICE, 1, 750))
    reached = population.evaluate_members()
    best = serial(CHOICE.utilities, None, 2, perception_bits=0.6, action_bits=0.4, restarts=2)
    for rates, budget in (
        (reached.perception_information / LN2, 0.6),
        (reached.action_information / LN2, 0.4),
        (reached.expected_utility, best.expected_utility),
        (population.beta_perception, best.beta_perception),
        (population.beta_action, best.beta_action),
    ):
        assert rates.tolist() == pytest.approx([budget] * 3, rel=0.02)


@pytest.mark.slow
def test_rates_that_are_drawn_come_to_the_budgets_on_average(tmp_path):
    """Within two standard errors of the mean over three members and twenty looks."""
    rule = ScoreFunction(samples=16, baseline="leave-one-out")
    population = make(3, update_rule=rule, perception_bits=0.6, beta_action=4.0)
    rates = []
    trainer = make_trainer(tmp_path, max_epochs=30)
    data = RolloutDataModule(CHOICE, 16, 50)
    population.on_train_epoch_end = lambda: rates.append(
        population.evaluate_members().perception_information / LN2
    )
    trainer.fit(population, data)
    late = torch.stack(rates[10:])
    error = (late.std() / late.numel() ** 0.5).item()
    assert late.mean().item() == pytest.approx(0.6, abs=2 * error) and error < 0.01


@pytest.mark.parametrize("rule", [Projection(), ScoreFunction()], ids=["projection", "online"])
@pytest.mark.parametrize("cooling", [None, Cooling(4, 8)], ids=["", "cooled"])
def test_members_go_the_ways_of_agents(tmp_path, double, rule, cooling):
    own = {"update_rule": rule, "cooling": cooling}
    short = {"updates": 16, "max_epochs": 1, "limit_val_batches": 0}
    population = make(**own, **BUDGETS)
    fit(population, tmp_path, **short)
    assert [s.perception_bits for s in population.settings] == [0.3, 0.3, 0.6, 0.6]
    for index, setting in enumerate(population.settings):
        bits = {"perception_bits": setting.perception_bits, "action_bits": setting.action_bits}
        agent = Agent(CHOICE, **(PARTS | own | bits | {"seed": setting.seed}))
        fit(agent, tmp_path, **short)
        member = population.member(index)
        assert setting.prices == member.prices == pytest.approx(agent.prices, rel=1e-9)
        assert 20.0 not in member.prices
        for name, tensor in agent.state_dict().items():
            torch.testing.assert_close(member.state_dict()[name], tensor, rtol=1e-9, atol=1e-9)
        judged = population.evaluate_members().objective[index].item()
        assert judged == pytest.approx(agent.evaluate().objective, rel=1e-9)


def test_prices_wait_until_cooling_is_over(tmp_path):
    population = make(cooling=Cooling(4, UPDATES_PER_EPOCH), **BUDGETS)
    assert population.prices[0].tolist() == [80.0] * 4
    fit(population, tmp_path, max_epochs=1)
    assert population.beta_perception.tolist() == population.beta_action.tolist() == [20.0] * 4


@pytest.mark.parametrize("compile", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_resumed_run_goes_on_bit_by_bit(tmp_path, compile):
    own = {"update_rule": ScoreFunction(), "compile": compile, **BUDGETS}
    straight, half = make(**own), tmp_path / "half.ckpt"
    fit(straight, tmp_path, max_epochs=2)
    keep = ModelCheckpoint(tmp_path, filename="half", every_n_train_steps=UPDATES_PER_EPOCH + 3)
    fit(make(**own), tmp_path, max_epochs=2, enable_checkpointing=True, callbacks=[keep])
    resumed = make(**own)
    fit(resumed, tmp_path, ckpt_path=half, max_epochs=2)
    assert_same_state(straight, resumed)
    assert resumed.settings == straight.settings
    loaded = Population.load_from_checkpoint(half)
    assert loaded.updates == UPDATES_PER_EPOCH + 3
    assert 20.0 not in [price for s in loaded.settings for price in s.prices]
    agent = Agent.load_from_checkpoint(half)
    assert agent.prices == loaded.best_agent().prices == loaded.member(loaded.best_index()).prices
    assert agent.budgets.limits == loaded.best_agent().budgets.limits


@pytest.mark.slow
def test_blocks_are_the_updates_that_they_stand_for(tmp_path, double):
    """Also where a member's prices wait for cooling within a block."""
    own = {"update_rule": ScoreFunction(), "cooling": Cooling(4, 7), **BUDGETS}
    eager, compiled = make(compile=False, **own), make(compile=True, **own)
    for population in (eager, compiled):
        fit(population, tmp_path, max_epochs=2)
    assert compiled._blocks is not None
    for name, tensor in eager.state_dict().items():
        torch.testing.assert_close(tensor, compiled.state_dict()[name], rtol=1e-9, atol=1e-9)
    assert eager.budgets.moved[:, 0].unique().numel() == 4


def test_the_best_member_is_the_best_at_the_price_of_its_budget(tmp_path):
    """E[U] − (I − B)/β, which does not sink with a price that falls."""
    population = make(2, perception_bits=0.5, action_bits=0.5)
    reached = population.evaluate_members()
    spent = reached.perception_information - 0.5 * LN2, reached.action_information - 0.5 * LN2
    worth = reached.expected_utility - (spent[0] + spent[1]) / 20
    assert population.best_index() == worth.argmax()
    assert make(2).best_index() == make(2).objectives().argmax()


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (
            {"perception_bits": [0.3, 0.6], "beta_perception": 2.0},
            "has a price and a budget: beta_perception 2.0 and perception_bits 0.3; leave one",
        ),
        ({"action_bits": [0.5, 0]}, "action_bits must be above 0, got 0"),
        ({"action_bits": []}, "action_bits must hold at least one number, got an empty list"),
        ({"perception_bits": [None, 1.0]}, "perception_bits must be a finite number"),
        (
            {"perception_bits": [0.1, 0.2, 0.3], "beta_action": [1.0, 2.0]},
            "must be of the same length, but beta_action has 2, perception_bits has 3",
        ),
    ],
)
def test_what_is_no_budget_is_refused(own, message):
    with pytest.raises(ValueError, match=message):
        make(**own)


def test_the_command_tells_what_every_budget_earns(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    task = ["--data.task=TableTask", "--data.task.utilities=[[1,0],[0,1]]"]
    quiet = ["--trainer.enable_progress_bar=false", "--behaviour=null", "--trainer.max_epochs=1"]
    logs = ["--trainer.logger=CSVLogger", "--trainer.logger.save_dir=logs"]
    model = ["--model.perception_bits=[0.25,0.5]", "--model.beta_action=5", "--model.replicas=2"]
    main(["fit", *task, *quiet, *logs, *model, "--data.updates_per_epoch=240"])
    shown = capsys.readouterr().out
    assert "median  " not in shown and "  I(Ω;X) 0.25, β₂ 5.0 bits" in shown
    folder = Path("logs/lightning_logs/version_0")
    rows = [*csv.DictReader((folder / "population.csv").open())]
    assert [row["perception_bits"] for row in rows] == ["0.25", "0.25", "0.5", "0.5"]
    assert all(float(row["gap"]) < 0.01 and row["beta_action"] == "5.0" for row in rows)
    curves = [*csv.DictReader((folder / "curves.csv").open())]
    prices = {row["updates"]: row["beta_perception"] for row in curves if row["agent"] == "3"}
    assert len(set(prices.values())) == 4 and prices["0"] == "20.0"
    logged = [*csv.DictReader((folder / "metrics.csv").open())]
    assert float(logged[0]["prices/beta_perception"]) == 20.0
    assert len({row["prices/beta_perception"] for row in logged}) == 4
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["perception_budget_nats"] == pytest.approx(0.5 * LN2)
    first, second = summary["prices"]
    assert first["perception_budget_nats"] == pytest.approx(0.25 * LN2)
    assert first["beta_perception"] is None and second["beta_action"] == 5.0
    main(["baseline", *task, *model, "--baseline.restarts=1"])
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["I(Ω;X)", "β₁", "I(X;A)", "β₂", "E[U]", "J", "bound"]
    assert [row.split()[0] for row in table[1:3]] == ["0.2500", "0.5000"] and len(table) == 4
    main(["baseline", *task, *model, "--baseline.restarts=1", "--json"])
    for bits, entry in zip((0.25, 0.5), json.loads(capsys.readouterr().out), strict=True):
        assert entry["perception_information_nats"] == pytest.approx(bits * LN2, abs=1e-5)
    with pytest.raises(SystemExit):
        main(["frontier", *task, "--model.perception_bits=0.5"])
    assert "got budgets; give one beta of each kind" in capsys.readouterr().err
    assert second["expected_utility_median"] > first["expected_utility_median"] > 0.7
