"""Prices that follow budgets of information."""

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

from bra import Agent, Cooling, RolloutDataModule, TableTask
from bra.blahut_arimoto import serial
from bra.budgets import PACE, WIDEST, Budgets
from bra.channels import MLP, Multinomial
from bra.cli import main
from bra.update_rules import Projection

LN2 = math.log(2)
CHOICE = TableTask([[1.0, 0.0], [0.0, 1.0]])
IN_YAML = ["--data.task=TableTask", "--data.task.utilities=[[1,0],[0,1]]"]
QUIET = ["--trainer.enable_progress_bar=false", "--behaviour=null", "--trainer.max_epochs=1"]


def make_agent(**own):
    parts = {
        "perception": MLP,
        "action": partial(Multinomial, start="covering"),
        "percepts": 2,
        "update_rule": Projection(),
        "perception_optimizer": partial(Adam, lr=0.05),
        "action_optimizer": partial(Adam, lr=0.1),
        "seed": 0,
    }
    return Agent(CHOICE, **(parts | own))


def test_rates_come_to_the_budgets_and_prices_to_those_of_the_optimum(tmp_path):
    agent = make_agent(perception_bits=0.6, action_bits=0.4)
    assert agent.prices == (20.0, 20.0)
    data = RolloutDataModule(CHOICE, 1, 600)
    make_trainer(tmp_path, max_epochs=1).fit(agent, data)
    reached = agent.evaluate()
    assert reached.perception_information / LN2 == pytest.approx(0.6, abs=0.02)
    assert reached.action_information / LN2 == pytest.approx(0.4, abs=0.02)
    best = serial(CHOICE.utilities, None, 2, perception_bits=0.6, action_bits=0.4, restarts=2)
    assert reached.expected_utility == pytest.approx(best.expected_utility, abs=0.01)
    assert agent.prices == pytest.approx((best.beta_perception, best.beta_action), rel=0.2)
    assert agent.settings[0].prices == agent.prices and agent.settings[0].budgets == (0.6, 0.4)


def test_a_price_may_stand_beside_a_budget():
    agent = make_agent(beta_perception=3.0, action_bits=0.4)
    assert agent.budgets is not None and agent.budgets.limits == (None, 0.4 * LN2)
    agent.budgets.follow(torch.tensor([0.1, 0.0]), 0)
    assert agent.prices == pytest.approx((3.0, 20.0 * math.exp(PACE)))
    assert make_agent().prices == (1.0, 1.0) and make_agent().budgets is None


def test_a_price_moves_by_what_is_missing():
    budgets = Budgets((0.5 / LN2, 0.5 / LN2), start=10.0)
    budgets.follow(torch.tensor([1.5, 0.0]), 0)
    assert budgets.moved.tolist() == pytest.approx([-PACE / 2, PACE])
    assert budgets.factors.log().tolist() == pytest.approx([-PACE / 2, PACE])
    budgets.moved.copy_(torch.tensor([math.log(WIDEST), -math.log(WIDEST)]))
    budgets.follow(torch.tensor([0.0, 9.0]), 1)
    assert budgets.factors.tolist() == pytest.approx([WIDEST, 1 / WIDEST])
    budgets.begins.fill_(3)
    budgets.follow(torch.tensor([1.5, 0.0]), 2)
    assert budgets.factors.tolist() == pytest.approx([WIDEST, 1 / WIDEST])


def test_prices_wait_until_cooling_is_over(tmp_path):
    cooling = Cooling(factor=4.0, updates=UPDATES_PER_EPOCH)
    agent = make_agent(perception_bits=0.1, action_bits=0.1, cooling=cooling)
    fit(agent, tmp_path, max_epochs=1)
    assert agent.beta_perception == agent.beta_action == 20.0
    assert make_agent(perception_bits=0.1, cooling=cooling).prices == (80.0, 4.0)


def test_a_resumed_run_goes_on_bit_by_bit(tmp_path):
    own = {"perception_bits": 0.3, "action_bits": 0.9}
    straight = make_agent(**own)
    fit(straight, tmp_path, max_epochs=2)
    keep = ModelCheckpoint(tmp_path, filename="half", save_on_train_epoch_end=True)
    fit(make_agent(**own), tmp_path, max_epochs=1, enable_checkpointing=True, callbacks=[keep])
    resumed = make_agent(**own)
    fit(resumed, tmp_path, ckpt_path=tmp_path / "half.ckpt", max_epochs=2)
    assert_same_state(straight, resumed)
    assert resumed.prices == straight.prices != (20.0, 20.0)
    loaded = Agent.load_from_checkpoint(tmp_path / "half.ckpt")
    assert loaded.updates == UPDATES_PER_EPOCH and 20.0 not in loaded.prices
    assert loaded.budgets.limits == straight.budgets.limits


def test_prices_may_be_others_than_those_of_a_checkpoint(tmp_path):
    half = tmp_path / "half.ckpt"
    fit(make_agent(perception_bits=0.3), tmp_path, max_epochs=1).save_checkpoint(half)
    own = {"beta_perception": 2.0, "action_bits": 0.9}
    other = Agent.load_from_checkpoint(half, perception_bits=None, beta_action=None, **own)
    assert other.prices == (2.0, 20.0)
    fit(resumed := make_agent(**own), tmp_path, ckpt_path=half, max_epochs=1)
    assert resumed.beta_perception == 2.0 and resumed.updates == UPDATES_PER_EPOCH
    plain = make_agent()
    trainer = fit(plain, tmp_path, ckpt_path=half, max_epochs=2)
    assert plain.prices == (1.0, 1.0)
    trainer.save_checkpoint(half)
    fit(led := make_agent(perception_bits=0.3), tmp_path, ckpt_path=half, max_epochs=2)
    assert led.prices == (20.0, 1.0)


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (
            {"perception_bits": 1.0, "beta_perception": 2.0},
            "the perception channel has a price and a budget: beta_perception 2.0 and "
            "perception_bits 1.0; leave one of them out",
        ),
        ({"action_bits": 0}, "action_bits must be above 0, got 0"),
        ({"action_bits": -1}, "action_bits must be a finite number of at least 0, got -1"),
        ({"perception_bits": math.inf}, "perception_bits must be a finite number"),
    ],
)
def test_what_is_no_budget_is_refused(own, message):
    with pytest.raises(ValueError, match=message):
        make_agent(**own)


@pytest.fixture
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


@pytest.mark.usefixtures("in_an_empty_folder")
def test_the_command_tells_budget_rate_and_price(capsys):
    budgets = ["--model.perception_bits=0.5", "--model.beta_action=5"]
    main(["fit", *IN_YAML, *budgets, *QUIET, "--data.updates_per_epoch=40"])
    shown = capsys.readouterr().out
    assert "  budget of I(Ω;X)          0.5 bits, at a price of β₁ " in shown
    assert "budget of I(X;A)" not in shown and "gap to the optimum" in shown
    summary = json.loads(Path("lightning_logs/version_0/summary.json").read_text())
    assert summary["perception_budget_nats"] == pytest.approx(0.5 * LN2)
    assert summary["action_budget_nats"] is None and summary["beta_action"] == 5.0
    checkpoint = "lightning_logs/version_0/checkpoints/last.ckpt"
    agent = Agent.load_from_checkpoint(checkpoint)
    assert summary["beta_perception"] == agent.beta_perception != 20.0
    main(["test", f"--ckpt_path={checkpoint}", "--trainer.enable_progress_bar=false"])
    assert f"{agent.evaluate().objective:.5f}" in capsys.readouterr().out
    main(["baseline", *IN_YAML, *budgets, "--baseline.restarts=1", "--json"])
    optimum = json.loads(capsys.readouterr().out)
    assert optimum["perception_information_nats"] == pytest.approx(0.5 * LN2, abs=1e-5)
    main(["baseline", *IN_YAML, *budgets, "--baseline.restarts=1"])
    assert "bits, at β₁ " in capsys.readouterr().out
