"""What utilities have in common moves no channel, and adds to J what it is."""

from functools import partial

import pytest
import torch
from torch.optim import SGD
from training import fit

from bra import Agent, Population, TableTask
from bra.channels import Table
from bra.marginals import BatchMarginals
from bra.update_rules import ExactGradient, Projection, ScoreFunction

UTILITIES = torch.tensor([[2.0, 0.5, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]).double()
PRIOR = [0.5, 0.3, 0.2]
PARTS = {
    "perception": Table,
    "action": Table,
    "percepts": 3,
    "perception_optimizer": partial(SGD, lr=0.1),
    "action_optimizer": partial(SGD, lr=0.1),
}
RULES = {
    "exact": (ExactGradient(), {}),
    "projection": (Projection(), {}),
    "score": (ScoreFunction(), {}),
    "running": (ScoreFunction(4, "running"), {"marginals": BatchMarginals()}),
    "leave-one-out": (ScoreFunction(4, "leave-one-out"), {}),
}
OFFSETS = {"shared": torch.tensor(1e8), "per state": torch.tensor([[-1e8], [1e9], [3e5]])}


LEARNERS = {"one": Agent, "many": partial(Population, replicas=2)}


def trained(rule, utilities, folder, learner=Agent):
    parts, own = RULES[rule]
    agent = learner(TableTask(utilities, PRIOR, "index"), seed=0, update_rule=parts, **PARTS, **own)
    fit(agent, folder, max_epochs=1)
    return agent


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("kind", OFFSETS)
@pytest.mark.parametrize("rule", RULES)
def test_far_utilities_move_channels_as_near_ones_do(rule, kind, learner, tmp_path):
    # The score function counts far utilities from a middle one.
    scores = isinstance(RULES[rule][0], ScoreFunction)
    middle = UTILITIES.median(-1, keepdim=True).values if scores else UTILITIES.new_zeros(3, 1)
    offset = OFFSETS[kind].double() + middle
    far = trained(rule, UTILITIES - middle + offset, tmp_path, LEARNERS[learner])
    near = trained(rule, UTILITIES - middle, tmp_path, LEARNERS[learner])
    for ours, theirs in zip(far.parameters(), near.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)
    level = (far.task.prior @ offset.expand(3, 1)).item()
    assert far.evaluate().objective - level == pytest.approx(near.evaluate().objective, abs=1e-5)
    assert far.terms.objective.amin() > 0.5 * level


def test_near_utilities_are_counted_from_zero(tmp_path):
    found = trained("score", UTILITIES, tmp_path).behaviour()
    moved = trained("score", UTILITIES + 1.0, tmp_path).behaviour()
    assert not torch.allclose(found, moved)
