"""Signals that leave states open: what is expected of them, and not what came of them, counts."""

from functools import partial

import pytest
import torch
from gymnasium.spaces import Discrete
from torch.optim import Adam
from training import fit

from bra import Agent, Population, TableTask
from bra.channels import Table
from bra.critics import StatePosterior
from bra.evaluation.references import solve_references
from bra.objective import table_objective
from bra.tasks import FiniteTask
from bra.tasks.signals import SignalTable, over_signals
from bra.update_rules import Projection, Rivals

WORTH = [[1.0, 0.0, 0.2], [0.0, 0.8, 0.1], [0.3, 0.0, 0.9]]
PRIOR = [0.5, 0.3, 0.2]
SHOWN = torch.tensor([[0.7, 0.3, 0.0], [0.2, 0.5, 0.3], [0.1, 0.3, 0.6]]).double()
PRICES = (20.0, 30.0)
PARTS = {
    "perception": Table,
    "action": partial(Table, start="covering"),
    "percepts": 3,
    "perception_optimizer": partial(Adam, lr=0.05),
    "action_optimizer": partial(Adam, lr=0.05),
}


class Slips(FiniteTask):
    """The same sensor, of which only draws are to be had."""

    def __init__(self):
        super().__init__(WORTH, PRIOR, observations=Discrete(3))

    def observe(self, state, generator):
        return torch.multinomial(SHOWN[state], 1, generator=generator)[:, 0]


KNOWN = TableTask(WORTH, PRIOR, "index", signal_given_state=SHOWN)


def exact(agent):
    """J over all signals."""
    utilities, mass = SignalTable(SHOWN).problem(KNOWN)
    percept = agent.perception.forward_all().probs.double()
    action = agent.action.forward_all().probs.double()
    return table_objective(mass, percept, action, utilities, *PRICES).objective.item()


def optimum():
    (reference,) = solve_references(KNOWN, Discrete(3), [PRICES], seed=0).values()
    return reference.objective


@pytest.mark.parametrize("learner", [Agent, partial(Population, replicas=2)], ids=["one", "many"])
def test_what_a_signal_says_is_learnt_beside_the_channels(learner, tmp_path):
    agent = learner(
        Slips(),
        beta_perception=PRICES[0],
        beta_action=PRICES[1],
        seed=0,
        **PARTS,
        update_rule=Projection(),
    )
    fit(agent, tmp_path, batch=128, updates=220, max_epochs=1)
    best = agent.best_agent()
    # Were states taken for known, perception would guess them as often as they occur: 0.04 less.
    assert exact(best) > optimum() - 0.015
    joint = torch.tensor(PRIOR).double()[:, None] * SHOWN
    found = best.update_rule.states(torch.arange(3))
    torch.testing.assert_close(found, (joint / joint.sum(0)).T, rtol=0, atol=0.08)


def test_known_noise_is_not_sampled(tmp_path):
    agent = Agent(
        KNOWN,
        beta_perception=PRICES[0],
        beta_action=PRICES[1],
        seed=0,
        **PARTS,
        update_rule=Projection(rivals=Rivals(20, 5, 50)),
    )
    assert not agent.update_rule.sees_worlds(agent.chain)
    fit(agent, tmp_path, updates=300, max_epochs=1)
    assert exact(agent) == pytest.approx(optimum(), abs=1e-3)


def test_agents_see_signals():
    seen = over_signals(KNOWN)
    assert seen.noiseless and seen.observation_space == KNOWN.observation_space
    assert seen.prior.tolist() == pytest.approx((torch.tensor(PRIOR).double() @ SHOWN).tolist())
    # E[U|s] at the first signal, by hand: states 0.35, 0.06 and 0.02 of 0.43.
    assert seen.utilities[0, 0].item() == pytest.approx((0.35 + 0.02 * 0.3) / 0.43)
    assert over_signals(Slips()).noiseless is False
    codes = TableTask(WORTH, PRIOR, "bipolar", signal_given_state=SHOWN)
    assert torch.equal(
        over_signals(codes).observations, TableTask(WORTH, PRIOR, "bipolar").observations
    )
    assert isinstance(Agent(codes).update_rule.rivals, Rivals)


def test_a_posterior_is_learnt_from_pairs():
    task = Slips()
    torch.manual_seed(0)
    states, generator = StatePosterior(task), torch.Generator().manual_seed(0)
    for _ in range(500):
        state, signal = task.sample(128, generator)
        states.learn(signal, state)
    joint = torch.tensor(PRIOR).double()[:, None] * SHOWN
    torch.testing.assert_close(states(torch.arange(3)), (joint / joint.sum(0)).T, rtol=0, atol=0.06)
