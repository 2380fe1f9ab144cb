"""What an agent is made of where nobody says."""

from functools import partial

import pytest
import torch
from gymnasium.spaces import Box, Discrete
from training import make_trainer

from bra import Agent, Cooling, Population, RolloutDataModule, TableTask, Task, World
from bra.agent.defaults import Parts, choose
from bra.blahut_arimoto import serial
from bra.channels import MLP, Multinomial, Table
from bra.checkpoints.recipes import unwrap_factory
from bra.critics import Exploration, NetworkCritic
from bra.tasks import FiniteTask, TargetTask
from bra.update_rules import Projection, Rivals, ScoreFunction

TABLE = TableTask(torch.rand(5, 3, generator=torch.Generator().manual_seed(0)))


class Noisy(FiniteTask):
    """Signals that are drawn."""

    def __init__(self):
        super().__init__(torch.eye(4), observations=Box(-9, 9, (4,)))

    def observe(self, state, generator):
        return torch.eye(4)[state] + 0.3 * torch.randn((len(state), 4), generator=generator)


class Dial(Task):
    """Says nothing of its states."""

    observation_space = Box(-9, 9, (1,))
    action_space = Discrete(2)

    def sample(self, count, generator):
        state = torch.randn(count, generator=generator)
        return World(state, state.unsqueeze(-1))

    def utility(self, state, action):
        return ((state > 0) == action.bool()).float()


def test_a_table_with_known_signals():
    found = choose(TABLE, Parts())
    assert found.percepts == 5
    assert isinstance(found.update_rule, Projection)
    assert isinstance(found.update_rule.rivals, Rivals)
    assert unwrap_factory(found.action) == (Multinomial, {"start": "covering"})
    assert found.cooling is None


def test_perception_learns_fast_where_signals_are_small():
    images = TableTask(torch.eye(2), observations=torch.ones(2, 1, 12, 16))
    rates = [unwrap_factory(choose(t, Parts()).perception_optimizer)[1] for t in (TABLE, images)]
    assert rates == [{"lr": 0.05}, {"lr": 0.01}]


@pytest.mark.parametrize("updates", [300, pytest.param(2000, marks=pytest.mark.slow)])
def test_short_runs_get_there(updates, tmp_path):
    """Those that rivals settle in have a test of the command, too."""
    agent = Agent(TABLE, beta_perception=8.0, beta_action=5.0, seed=0)
    trainer = make_trainer(tmp_path, max_epochs=1)
    trainer.fit(agent, RolloutDataModule(TABLE, batch_size=1, updates_per_epoch=updates))
    best = serial(TABLE.utilities, TABLE.prior, 5, 8.0, 5.0).objective
    assert best - agent.evaluate().objective < 0.01 * TABLE.utility_range


def test_a_table_with_noisy_signals():
    found = choose(Noisy(), Parts())
    assert isinstance(found.update_rule, Projection)
    assert found.update_rule.rivals is None
    assert found.update_rule.critic is None
    assert found.cooling == Cooling(16.0, 0.4)


def test_utilities_of_taken_actions_only():
    found = choose(Dial(), Parts())
    assert found.percepts == 2
    assert isinstance(found.update_rule.critic, NetworkCritic)
    assert found.update_rule.exploration == Exploration(0.3, 0.4, 0.1)
    assert found.cooling == Cooling(16.0, 0.3)


@pytest.mark.parametrize(
    ("task", "given"),
    [(TargetTask([[0.0], [1.0]]), {}), (TABLE, {"percepts": Box(-3, 3, (2,))})],
    ids=["actions", "percepts"],
)
def test_densities(task, given):
    found = choose(task, Parts(**given))
    assert isinstance(found.update_rule, ScoreFunction)
    assert (found.update_rule.samples, found.update_rule.baseline) == (8, "leave-one-out")
    assert found.cooling == Cooling(4.0, 0.4)
    Agent(task, **given)


@pytest.mark.parametrize("task", [TABLE, Noisy(), Dial()], ids=["table", "noisy", "taken"])
def test_what_is_chosen_makes_agents_and_populations(task):
    agent, population = Agent(task, seed=0), Population(task, 2, seed=0)
    assert agent.chosen == population.chosen
    assert agent.chosen.startswith("chosen for this task: percepts ")
    assert "\n" not in agent.chosen
    ours, theirs = agent.state_dict(), population.member(0).state_dict()
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        assert torch.equal(tensor, theirs[name])


GIVEN = {
    "percepts": 2,
    "update_rule": Projection(decay=0.5),
    "perception": Table,
    "action": partial(Table, start="covering"),
    "perception_optimizer": partial(torch.optim.SGD, lr=0.1),
    "action_optimizer": partial(torch.optim.SGD, lr=0.2),
    "cooling": Cooling(1.0, 1),
}


@pytest.mark.parametrize("name", GIVEN)
def test_each_part_may_be_given(name):
    found = choose(TABLE, Parts(**{name: GIVEN[name]}))
    assert getattr(found, name) is GIVEN[name]
    task = TableTask(torch.eye(3), observations="index")
    line = Agent(task, **{name: GIVEN[name]}).chosen
    assert not any(part.startswith(f"{name} ") for part in line.split(": ")[1].split(", "))


def test_all_parts_given_leave_nothing_to_say():
    task = TableTask(torch.eye(3), observations="index")
    assert Agent(task, **GIVEN).chosen == ""


def test_a_rule_that_is_given_comes_as_it_is():
    found = choose(TABLE, Parts(update_rule=ScoreFunction()))
    assert found.perception is MLP
    assert found.action is Multinomial
    assert found.cooling is None
