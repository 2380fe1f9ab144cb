"""A member of a population goes the way that an agent goes alone."""

import math
from functools import partial

import pytest
import torch
from gymnasium.spaces import Box, Discrete
from populations import SETTINGS, Dropping, Sensor, alone, fit, make_population
from torch.distributions import Categorical
from torch.optim.lr_scheduler import ExponentialLR

from bra import Agent, Cooling, TableTask
from bra.channels import CNN, MLP, Channel, Gaussian, Multinomial, Table
from bra.critics import Exploration, NetworkCritic, TableCritic
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.tasks import Medical, TargetTask, Task, World
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction


@pytest.fixture
def double():
    """Float64, so that rounding tips no draw."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def assert_close(member: Agent, agent: Agent, atol: float) -> None:
    assert member.updates == agent.updates
    assert member.samples == agent.samples
    ours, theirs = member.state_dict(), agent.state_dict()
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        torch.testing.assert_close(tensor, theirs[name], rtol=atol, atol=atol)


def assert_members_equal_agents(
    folder, updates=10, batch_size=4, atol=1e-9, varied=None, members=(0, 3), **own
):
    """Those of the first price and seed and of the last, unless others are asked for."""
    population = make_population(**(varied or {}), **own)
    fit(population, folder, updates, batch_size)
    for index in members:
        agent = alone(population, index, **own)
        fit(agent, folder, updates, batch_size)
        assert_close(population.member(index), agent, atol)
        judged = population.member(index).evaluate().objective
        assert population.objectives()[index].item() == pytest.approx(judged, abs=1e-6)


@pytest.mark.parametrize("rule", [Projection(), ExactGradient()], ids=["projection", "gradient"])
def test_without_draws_in_float32(tmp_path, rule):
    assert_members_equal_agents(
        # Rounding, which depends on the machine, is carried through the updates.
        tmp_path,
        24,
        8,
        atol=3e-4,
        members=range(4),
        update_rule=rule,
        cooling=Cooling(4, 12),
    )


RULES = {
    "projection": Projection(),
    "rivals": Projection(rivals=Rivals(count=2, sweeps=4, lead=6)),
    "gradient": ExactGradient(),
    "online": ScoreFunction(),
    "running": ScoreFunction(samples=2, baseline="running"),
    "leave-one-out": ScoreFunction(samples=2, baseline="leave-one-out"),
}


@pytest.mark.parametrize(
    ("rule", "batch_size"),
    [
        *((rule, 4) for rule in RULES),
        *((rule, 1) for rule in RULES if isinstance(RULES[rule], ScoreFunction)),  # others see all
    ],
)
def test_rules(tmp_path, double, rule, batch_size):
    assert_members_equal_agents(
        tmp_path, 12, batch_size, update_rule=RULES[rule], cooling=Cooling(4, 6)
    )


@pytest.mark.parametrize(
    "marginals", [ExactMarginals(), BatchMarginals(), RunningMarginals(0.9)], ids=repr
)
def test_marginals(tmp_path, double, marginals):
    assert_members_equal_agents(tmp_path, marginals=marginals, update_rule=ScoreFunction(2))


IMAGES = torch.rand(4, 1, 5, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("perception", "action", "observations"),
    [
        (partial(CNN, channels=[2]), Table, IMAGES),
        (Table, partial(Multinomial, reference=2), "index"),
        (partial(MLP, hidden=[3, 3], activation=torch.nn.ReLU), MLP, "onehot"),
        (Multinomial, partial(Table, start="covering"), "index"),
    ],
    ids=["cnn-table", "table-multinomial", "mlp-mlp", "multinomial-table"],
)
@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_channels(tmp_path, double, perception, action, observations, rule):
    task = TableTask([[1.0, 0, 0], [0, 2, 0], [0, 0, 3], [1, 1, 1]], None, observations)
    assert_members_equal_agents(
        tmp_path,
        12,
        task=task,
        perception=perception,
        action=action,
        percepts=3,
        update_rule=RULES[rule],
    )


@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_a_noisy_sensor(tmp_path, double, rule):
    assert_members_equal_agents(
        tmp_path, 12, task=Sensor(), percepts=4, update_rule=RULES[rule], batch_size=6
    )


class Dial(Task):
    """A world without a list of states: say whether a noisy reading of ω ~ N(0, 1) is positive."""

    observation_space = Box(-9, 9, (1,))
    action_space = Discrete(2)

    def sample(self, count, generator):
        state, noise = torch.randn((2, count), generator=generator)
        return World(state, (state + 0.1 * noise).unsqueeze(-1))

    def utility(self, state, action):
        return ((state > 0) == action.bool()).to(torch.get_default_dtype())


@pytest.mark.parametrize("rule", ["projection", "online"])
def test_a_world_without_a_list_of_states(tmp_path, double, rule):
    assert_members_equal_agents(tmp_path, 12, task=Dial(), percepts=3, update_rule=RULES[rule])


CRITICS = {
    "table": (TableCritic(start=5.0), SETTINGS["task"]),
    "network": (NetworkCritic(hidden=[6], start=2.5, memory=20, batch_size=5), SETTINGS["task"]),
    "noisy sensor": (NetworkCritic(hidden=[6], memory=20, batch_size=5, steps=2), Sensor()),
    "no states": (NetworkCritic(hidden=[6], memory=20, batch_size=5), Dial()),
}


@pytest.mark.parametrize("critic", CRITICS)
def test_critics(tmp_path, double, critic):
    made, task = CRITICS[critic]
    rule = Projection(critic=made, exploration=Exploration(0.3, 12, uniform_updates=4))
    assert_members_equal_agents(tmp_path, 16, task=task, update_rule=rule, batch_size=2)


def test_members_with_critics_are_one_batch(tmp_path, monkeypatch):
    made, task = CRITICS["noisy sensor"]
    rule = Projection(critic=made, exploration=Exploration(0.3, 40, uniform_updates=10))
    population = make_population(task=task, update_rule=rule)

    def in_turn(*_):
        raise AssertionError("members took turns")

    monkeypatch.setattr(population._stacked_loss, "_in_turn", in_turn)
    fit(population, tmp_path, 5)
    assert population.state_dict()["update_rule.critic.replay.written"].tolist() == [20] * 4


def test_members_go_the_ways_of_their_own_factors(tmp_path, double):
    cooling = Cooling(factor=[2.0, 16.0], updates=9, action_factor=[0.25, 4.0])
    assert_members_equal_agents(tmp_path, 12, cooling=cooling)
    members = make_population(cooling=cooling, replicas=3, beta_perception=8.0)
    scales = {members.member(index).prices[0] for index in range(3)}
    assert len(scales) == 3


@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_specialists(tmp_path, double, rule):
    """Members whose actions look at the signal again, at a third price that cools too."""
    own = {"task": Medical(), "beta_direct": 0.9, "action": partial(MLP, hidden=[4])}
    cooling = Cooling(factor=[2.0, 16.0], updates=10)
    free = {"beta_action": [10.0, math.inf]}
    own |= {"update_rule": RULES[rule], "cooling": cooling}
    assert_members_equal_agents(tmp_path, 14, varied=free, **own)
    with pytest.raises(ValueError, match="beta_action must be positive and finite, got inf"):
        make_population(beta_action=[10.0, math.inf])


def test_densities_take_turns(tmp_path, double, monkeypatch):
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 64)
    assert_members_equal_agents(
        tmp_path,
        10,
        task=TargetTask([[0.0], [1.0]], observations="index"),
        perception=Gaussian,
        action=partial(MLP, hidden=[4]),
        percepts=Box(-3, 3, (2,)),
        update_rule=ScoreFunction(2),
    )


def test_channels_that_draw_take_turns(tmp_path, double):
    assert_members_equal_agents(tmp_path, 12, perception=Dropping, update_rule=Projection())


OPTIMIZERS = {
    "descent": partial(torch.optim.SGD, lr=0.1),
    "sgd": partial(torch.optim.SGD, lr=0.1, momentum=0.9, weight_decay=0.01),
    "adamw": partial(torch.optim.AdamW, lr=0.01),
    "rmsprop": partial(torch.optim.RMSprop, lr=0.01, momentum=0.5),
}


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_every_member_has_its_own_rates(tmp_path, double, optimizer):
    assert_members_equal_agents(
        tmp_path,
        20,
        members=(0, 2),
        varied={
            "replicas": 1,
            "beta_perception": [8.0, 1.0, 2.0],
            "perception_rate": [0.001, 0.01, 0.1],
            "action_rate": [0.1, 0.03, 0.02],
        },
        perception_optimizer=OPTIMIZERS[optimizer],
        action_optimizer=OPTIMIZERS[optimizer],
        perception_scheduler=partial(ExponentialLR, gamma=0.9),
        atol=1e-8,
    )


def test_tied_parameters_stay_tied(tmp_path, double):
    assert_members_equal_agents(tmp_path, 12, perception=Tied)


class Tied(Channel):
    """One matrix used twice."""

    def __init__(self, condition_space, outcome_space):
        super().__init__(condition_space, outcome_space)
        self.first = torch.nn.Linear(4, 4)
        self.second = torch.nn.Linear(4, 4)
        self.second.weight = self.first.weight
        self.last = torch.nn.Linear(4, int(outcome_space.n))

    def forward(self, condition):
        logits = self.last(self.second(self.first(condition.to(self.first.weight.dtype)).tanh()))
        return Categorical(logits=logits, validate_args=False)


class Halting(ScoreFunction):
    """Ties the perception channel's gradient to nothing."""

    def loss(self, chain, world):
        loss, terms = super().loss(chain, world)
        action_loss = -chain.action.forward_all().logits[:, 0].sum()
        return action_loss + 0.0 * loss.detach(), terms


def test_parameters_that_the_loss_knows_nothing_of_stay(tmp_path):
    decaying = partial(torch.optim.SGD, lr=0.1, weight_decay=0.1)
    assert_members_equal_agents(
        tmp_path, 5, update_rule=Halting(), perception_optimizer=decaying, atol=1e-6
    )
