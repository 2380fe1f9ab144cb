"""Utilities learnt from taken actions, and the projection rule that lives on them."""

import copy
import math
from functools import partial

import numpy as np
import pytest
import torch
from critic_agents import UTILITIES, Frames, make_agent
from gymnasium.spaces import Box

from bra import Agent, PredatorPrey, TableTask
from bra.channels import Gaussian
from bra.critics import Critic, Exploration, NetworkCritic, TableCritic
from bra.critics.replay import Replay
from bra.tasks import TargetTask
from bra.update_rules import Projection


@pytest.mark.parametrize("observations", ["index", "bipolar", [[[1.0, 2.0]], [[3.0, 4.0]]]])
def test_table_critic_is_a_running_mean_with_a_start(observations):
    task = TableTask(UTILITIES, observations=observations)
    critic = TableCritic(start=7.0)
    critic.check(task)
    signals = task.observations
    assert torch.equal(critic(signals), torch.full((2, 3), 7.0).double())
    take = partial(map, torch.tensor)
    for states, actions, utilities in (
        ([0, 0, 1], [1, 1, 2], [1.0, 2.0, 5.0]),
        ([0], [1], [6.0]),
    ):
        state, action, utility = take([states, actions, utilities])
        critic.take(signals[state], action, utility)
    expected = torch.tensor([[7.0, 3.0, 7.0], [7.0, 7.0, 5.0]])
    torch.testing.assert_close(critic(signals), expected.double())
    # Errors before learning: mean of 36, 25, 4, then 4.5², later ones weighing more by 1/0.99.
    squares = [65 / 3, 20.25]
    mean = (0.99 * squares[0] + squares[1]) / 1.99
    assert critic.rmse == pytest.approx(math.sqrt(mean), rel=1e-5)


def test_network_critic_fits_what_was_taken_and_starts_where_told():
    task = Frames()
    critic = NetworkCritic(hidden=[32], start=2.5, memory=500, batch_size=64, steps=2, lr=0.01)
    torch.manual_seed(0)
    critic.check(task)
    assert critic(torch.zeros(4, 3)).tolist() == [[2.5] * 3] * 4
    generator = torch.Generator().manual_seed(0)
    for _ in range(400):
        state, signal = task.sample(4, generator)
        action = torch.randint(3, (4,), generator=generator)
        critic.take(signal, action, torch.tensor(UTILITIES).double()[state, action])
    fitted = critic(torch.tensor([[1.0, 0, 1], [0, 1, 1]]))
    torch.testing.assert_close(fitted, torch.tensor(UTILITIES).double(), rtol=0, atol=0.1)
    assert critic.rmse < 0.2
    assert not any(weight.requires_grad for weight in critic.parameters())


def test_what_the_network_critic_learns_by_is_adam():
    # It recalls the last triplet, and counts in units of the largest utility so far.
    critic = NetworkCritic(hidden=[5], start=0.0, memory=1, batch_size=4, lr=0.02)
    torch.manual_seed(0)
    critic.check(Frames())
    network = copy.deepcopy(critic.network.layers).requires_grad_()
    adam = torch.optim.Adam(network.parameters(), lr=0.02)
    reach = 0.0
    for _ in range(5):
        signal, action, utility = torch.randn(1, 3), torch.randint(3, (1,)), torch.randn(1)
        critic.take(signal, action, utility)
        reach = max(reach, utility.abs().item())
        adam.zero_grad()
        (network(signal)[0, action] - utility / reach).square().mean().backward()
        adam.step()
    for ours, theirs in zip(critic.network.layers.parameters(), network.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs.detach())


def test_replay_keeps_the_last_triplets():
    replay = Replay(5)
    replay.make_room(Box(0, 255, (1, 2), np.uint8))
    for k in range(4):
        numbers = torch.arange(3 * k, 3 * k + 3)
        signal = numbers.to(torch.uint8).reshape(3, 1, 1).expand(3, 1, 2)
        replay.add(signal, numbers, numbers.float())
        torch.manual_seed(0)
        observation, action, utility = replay.draw(200)
        assert set(action.tolist()) == set(range(max(0, 3 * k - 2), 3 * k + 3))
        assert torch.equal(observation[:, 0, 1].long(), action)
        assert torch.equal(utility.long(), action)
    assert observation.dtype == torch.uint8
    replay.add(signal.repeat(4, 1, 1), torch.arange(12), torch.arange(12.0))
    assert set(replay.draw(200)[1].tolist()) == set(range(7, 12))


@pytest.mark.parametrize("critic", [TableCritic(1.0), NetworkCritic()])
def test_continuous_actions_are_refused(critic):
    task = TargetTask([[0.0], [1.0]], observations="index")
    name = type(critic).__name__
    with pytest.raises(ValueError, match=rf"{name} values Discrete actions, got Box.*; use Score"):
        critic.check(task)
    with pytest.raises(ValueError, match=r"needs actions that can be enumerated.*; use Score"):
        make_agent(task, critic, action=Gaussian)


@pytest.mark.parametrize("critic", [TableCritic(1.0), NetworkCritic()], ids=["table", "network"])
def test_a_single_action_is_refused(critic):
    message = rf"{type(critic).__name__} values actions to choose from, and TableTask has one only"
    with pytest.raises(ValueError, match=message):
        make_agent(TableTask([[1.0], [2.0]]), critic)


class Pairs(Critic):
    """Of percept and signal, which no critic is given."""

    def make_room(self, task, actions):
        percepts, _ = task.observation_space
        self.value = torch.zeros(int(percepts.n), actions)

    def forward(self, observation):
        return self.value[observation[0]]

    def learn(self, observation, action, utility, uniform):
        pass


def test_spaces_that_a_critic_of_ones_own_is_not_made_for():
    with pytest.raises(
        TypeError, match=r"^critic: Pairs has no room for signals Box\(0.0, 1.0, "
    ) as e:
        Agent(PredatorPrey(), percepts=3, beta_direct=2.0, update_rule=Projection(critic=Pairs()))
    assert str(e.value).endswith("Box object; a critic is given signals and no percepts")


def test_endless_signals_are_refused_by_the_table():
    message = r"TableCritic needs finitely many signals, got Box.* of Frames; use NetworkCritic"
    with pytest.raises(ValueError, match=message):
        make_agent(Frames(), TableCritic(1.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (partial(TableCritic, math.inf), "start must be finite, got inf"),
        (partial(NetworkCritic, start=math.nan), "start must be finite, got nan"),
        (partial(NetworkCritic, hidden=[0]), r"hidden sizes must be at least 1, got \[0\]"),
        (partial(NetworkCritic, lr=0.0), "lr must be positive and finite, got 0.0"),
        (partial(NetworkCritic, steps=0), "steps must be a whole number of at least 1, got 0"),
        (partial(NetworkCritic, memory=0), "memory must be a whole number of at least 1, got 0"),
        (partial(NetworkCritic, batch_size=0), "batch_size must be a whole number"),
        (partial(Exploration, share=1.5), "exploration share must be between 0 and 1, got 1.5"),
        (partial(Exploration, updates=0), "exploration updates must be a whole number"),
        (partial(Exploration, uniform_updates=-1), "exploration uniform_updates must be a whole"),
        (partial(Projection, exploration=Exploration()), "exploration serves a critic, got none"),
    ],
)
def test_bad_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
