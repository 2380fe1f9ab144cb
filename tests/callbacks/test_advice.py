"""The line that a run ends with when it misses the optimum."""

from dataclasses import replace

import pytest

from bra import Agent, Cooling, TableTask
from bra.blahut_arimoto import serial
from bra.callbacks.advice import advice
from bra.evaluation.references import Reference
from bra.tasks import TargetTask
from bra.update_rules import Projection, Rivals, ScoreFunction

TABLE = [[3.0, 1.0], [0.0, 5.0]]
QUICK = Rivals(count=3, sweeps=2, lead=4)
STEPS = {
    "prices reach their own after 40 updates; train longer": {"cooling": Cooling(4, 40)},
    "leave update_rule out, which then is chosen for the task": {"update_rule": ScoreFunction()},
    "give update_rule Projection its rivals, or leave it out": {"update_rule": Projection()},
    "rivals settle after 30 updates; train longer": {
        "update_rule": Projection(rivals=Rivals(count=5, sweeps=4, lead=10))
    },
    "train several seeds, --model.replicas 16, and longer, --trainer.max_epochs": {
        "update_rule": Projection(rivals=QUICK)
    },
}


def agent_after(updates, unit=1.0, **own):
    table = [[unit * value for value in row] for row in TABLE]
    settings = {"percepts": 2, "seed": 0, "cooling": None} | own
    if settings["cooling"] is None:
        settings["cooling"] = Cooling(1.0, 1)
    agent = Agent(TableTask(table), **settings)
    agent.updates = updates
    return agent


@pytest.mark.parametrize("step", STEPS)
def test_what_to_do_next(step):
    line = advice(agent_after(20, **STEPS[step]), 0.5)
    assert line == f"J misses the optimum by 10.0% of the range of utilities: {step}"


def test_populations_have_their_seeds_already():
    line = advice(agent_after(20, update_rule=Projection(rivals=QUICK)), 0.5, replicas=16)
    assert line.endswith("train longer, --trainer.max_epochs, or give perception more hidden units")


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_a_hundredth_of_the_range_is_near_enough_in_every_unit(unit):
    agent = agent_after(20, unit)
    assert advice(agent, 0.0499 * unit) == ""
    assert "by 1.0% of the range" in advice(agent, 0.0501 * unit)


def test_nothing_is_said_of_gaps_that_are_not_known():
    assert advice(agent_after(20), None) == ""
    assert advice(Agent(TargetTask([[1.0]]), percepts=2, seed=0), 5.0) == ""


def test_an_optimum_that_was_hit_once_says_so():
    found = serial(TABLE, None, 2, 2.0, 2.0)
    assert Reference(found).note == ""
    line = "one start alone led to the optimum; other seeds may find a better one"
    assert Reference(replace(found, hits=1)).note == line
    assert Reference(reason="percepts are a Box").note == "no optimum: percepts are a Box"
