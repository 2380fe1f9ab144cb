"""Prices of a population: exact, whatever the precision of the channels."""

import pytest
import torch
from training import make_trainer

from bra import Agent, Cooling, Population, PredatorPrey, RolloutDataModule


def make(**own):
    prices = {"beta_perception": [0.3, 7.1], "beta_action": 10.0}
    return Population(PredatorPrey(), **({"replicas": 1, "percepts": 5, "seed": 0} | prices | own))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_prices_keep_their_digits_in_any_precision(dtype):
    population = make().to(dtype)
    assert population.beta_perception.tolist() == [0.3, 7.1]
    assert population.beta_action.dtype == torch.float64


def test_members_are_judged_as_the_agents_that_they_are():
    population = make()
    for index, objective in enumerate(population.objectives()):
        assert objective.item() == pytest.approx(
            population.member(index).evaluate().objective, abs=1e-12
        )


def test_cooled_prices_are_those_of_single_agents():
    population = make(cooling=Cooling(factor=[2.0, 16.0], updates=100, action_factor=0.5))
    for update in (0, 37, 99, 100, 500):
        population.updates = update
        for index, pair in enumerate(zip(*population.prices, strict=True)):
            assert [price.item() for price in pair] == pytest.approx(
                population.member(index).prices, rel=1e-14
            )


@pytest.mark.parametrize("kind", ["agent", "population"])
def test_one_evaluation_serves_all_who_ask_at_an_update(kind, tmp_path):
    learner = Agent(PredatorPrey(), seed=0) if kind == "agent" else make()
    judged = learner.evaluation if kind == "agent" else learner.evaluate_members
    first = judged()
    assert learner.evaluate() == learner.best_agent().evaluate()
    assert judged() is first
    with torch.no_grad():
        next(learner.action.parameters()).add_(torch.rand(()))
    second = judged()
    assert second is not first
    assert judged() is second
    data = RolloutDataModule(learner.task, 1, updates_per_epoch=1)
    make_trainer(tmp_path, max_epochs=1).fit(learner, data)
    assert judged() is not second


def test_what_was_made_in_inference_mode_can_be_judged():
    with torch.inference_mode():
        agent = Agent(PredatorPrey(), seed=0)
        inside = agent.evaluate()
        member = make().member(0)
    assert agent.evaluate() == inside
    assert member.evaluate().objective == pytest.approx(make().objectives()[0].item(), abs=1e-12)
