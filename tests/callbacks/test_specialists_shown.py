"""What people are shown of agents whose actions look at the signal again."""

import csv
import json
import math

import pytest
import torch
from training import fit

from bra import Agent, TableTask
from bra.blahut_arimoto import general
from bra.callbacks.behaviour import behaviour_figures
from bra.callbacks.information import FLOW, information_flow
from bra.callbacks.summary import summarise
from bra.channels import Table
from bra.cli.export import export
from bra.frontiers import frontier
from bra.frontiers.picture import draw_frontier

TASK = TableTask([[3.0, 0, 1], [0, 3, 1], [0, 1, 3]], [0.5, 0.3, 0.2], "index")
PRICES = (4.0, 3.0, 1.5)


def make_agent():
    betas = dict(zip(("beta_perception", "beta_action", "beta_direct"), PRICES, strict=True))
    return Agent(TASK, Table, Table, 2, seed=0, **betas)


@pytest.fixture(scope="module")
def optimum():
    return general(TASK.utilities, TASK.prior, 2, *PRICES, restarts=4, budget=4)


def test_information_flows_one_on_top_of_the_other():
    terms = make_agent().evaluate()
    flow = information_flow(terms)
    assert [*flow] == [*FLOW]
    steps = [terms.perception_information, terms.action_information, terms.direct_information]
    heights = [sum(steps[: n + 1]) / math.log(2) for n in range(3)]
    assert [*flow.values()] == pytest.approx(heights)
    assert information_flow(Agent(TASK, percepts=2, seed=0).evaluate()) == {}


def test_specialists_have_a_picture_of_their_own(optimum):
    agent = make_agent()
    figures = behaviour_figures(agent, optimum)
    pictured = figures["p_action_given_percept_and_state"]
    assert pictured.height > figures["p_action_given_percept"].height
    plain = behaviour_figures(Agent(TASK, percepts=2, seed=0))
    assert figures.keys() - plain.keys() == {"p_action_given_percept_and_state"}


def test_export_writes_what_specialists_do(tmp_path):
    agent = make_agent()
    trainer = fit(agent, tmp_path, max_epochs=1)
    trainer.save_checkpoint(tmp_path / "agent.ckpt")
    export(str(tmp_path / "agent.ckpt"), str(tmp_path / "tables"))
    with (tmp_path / "tables" / "action_given_percept_and_state.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 3 * 3  # agent and optimum
    assert {row["source"] for row in rows} == {"agent", "optimum"}
    own = [float(row["probability"]) for row in rows if row["source"] == "agent"]
    looks = agent.evaluation().action_given_percept_and_state
    assert own == pytest.approx(looks.flatten().tolist())
    with (tmp_path / "tables" / "action_given_state.csv").open() as file:
        shown = [float(r["probability"]) for r in csv.DictReader(file) if r["source"] == "agent"]
    assert shown == pytest.approx(agent.behaviour().flatten().tolist())


def test_frontiers_scale_three_prices():
    found = frontier(TASK, 4.0, float("inf"), 2, points=4, restarts=2, beta_direct=1.5)
    torch.testing.assert_close(found.beta_direct, found.beta_perception * 1.5 / 4)
    assert found.beta_action.isinf().all()
    row = found.rows()[-1]
    assert row["direct_information_nats"] > 0.1
    cost = found.perception_information / found.beta_perception
    cost += found.direct_information / found.beta_direct
    torch.testing.assert_close(found.objective, found.expected_utility - cost)
    assert (found.objective <= found.upper_bound + 1e-9).all()
    assert (found.expected_utility <= found.utility_bound + 1e-9).all()
    labels = [axes.get_xlabel() for axes in draw_frontier(found).axes]
    assert labels[2] == "I(Ω;A|X) in bits"
    plain = frontier(TASK, points=2, percepts=2, restarts=2)
    assert plain.beta_direct is None
    assert "beta_direct" not in plain.rows()[0]


def test_summaries_have_the_third_price_and_finite_numbers():
    agent = Agent(TASK, percepts=2, beta_action=float("inf"), beta_direct=1.5, seed=0)
    fields = summarise(agent, None, 0.0).fields()
    assert fields["beta_direct"] == 1.5
    assert json.loads(json.dumps(fields, allow_nan=False))["beta_action"] is None
