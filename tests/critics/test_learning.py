"""What critics learn while agents are trained."""

from collections import Counter

import pytest
import torch
from critic_agents import UTILITIES, Frames, make_agent
from lightning.pytorch.callbacks import ModelCheckpoint
from training import assert_same_state, fit

from bra import Agent, Cooling, PredatorPrey, TableTask
from bra.callbacks import InformationMonitor
from bra.critics import Exploration, NetworkCritic, TableCritic
from bra.tasks import World
from bra.update_rules import Chain, Projection


class Counting(PredatorPrey):
    """Counts which utilities it was asked for."""

    def __init__(self):
        super().__init__(observations="bipolar")
        self.asked = Counter()

    def utility(self, state, action):
        self.asked.update(zip(state.tolist(), action.tolist(), strict=True))
        return super().utility(state, action)


def train(agent, updates, batch=1):
    """Updates without the trainer's checkpoints and loggers."""
    (perception, action), _ = agent.configure_optimizers()
    for update in range(updates):
        torch.manual_seed(update)
        world = agent.task.sample(batch, torch.Generator().manual_seed(update))
        loss, agent.terms = agent.update_rule.loss(agent.coming_chain(), world)
        for optimizer in (perception, action):
            optimizer.zero_grad()
        loss.backward()
        for optimizer in (perception, action):
            optimizer.step()
        agent.updates += 1
    return agent


@pytest.mark.parametrize("kind", ["table", "network"])
@pytest.mark.parametrize(("offset", "unit"), [(1e8, 1.0), (-1e8, 1.0), (0.0, 1000.0), (0.0, 1e-3)])
def test_critics_learn_the_same_whatever_utilities_are_counted_in(kind, offset, unit):
    def learnt(offset, unit):
        start = 1.5 * unit + offset
        critic = TableCritic(start) if kind == "table" else NetworkCritic(memory=50)
        torch.manual_seed(0)
        critic.check(TableTask(UTILITIES, observations=[[0.0, 1, 1], [1, 0, 1]]))
        generator = torch.Generator().manual_seed(0)
        for _ in range(60):
            state, action = torch.randint(2, (2, 4), generator=generator)
            utility = torch.tensor(UTILITIES).double()[state, action] * unit + offset
            critic.take(critic_signals[state], action, utility)
        return (critic(critic_signals) - offset) / unit, critic.rmse / unit

    critic_signals = torch.tensor([[0.0, 1, 1], [1, 0, 1]])
    (near, error), (far, far_error) = learnt(0.0, 1.0), learnt(offset, unit)
    torch.testing.assert_close(far, near, rtol=0, atol=1e-5)
    assert far_error == pytest.approx(error, rel=1e-4)


@pytest.mark.parametrize("exploration", [None, Exploration(share=0.5, updates=50)])
def test_utilities_are_asked_of_taken_actions_only(exploration):
    task = Counting()
    agent = make_agent(task, TableCritic(5.0), exploration, percepts=13)
    train(agent, 60)
    assert task.asked.total() == 60
    critic = agent.update_rule.critic
    assert critic.count.sum() == 60
    for (state, action), times in task.asked.items():
        assert critic.count[state, action] == times
        valued = critic(task.observations)[state, action].item()
        assert valued == pytest.approx(task.utilities[state, action].item())


def test_exploration_is_uniform_then_falls_and_channels_wait():
    exploration = Exploration(share=0.4, updates=100, uniform_updates=20)
    probabilities = [exploration.probability(k) for k in (0, 19, 20, 50, 100, 1000)]
    assert probabilities == pytest.approx([1, 1, 0.32, 0.2, 0, 0])
    task = Frames()
    agent = make_agent(task, NetworkCritic(), exploration)
    before = {name: value.clone() for name, value in agent.state_dict().items()}
    train(agent, 20, batch=50)
    after = agent.state_dict()
    for name in before:
        if not name.startswith("marginals"):
            moved = not torch.equal(before[name], after[name])
            assert moved == name.startswith("update_rule"), name
    # 1000 uniform actions: each a third, within six standard deviations of 15.
    actions = torch.cat([action for _, action in task.asked])
    assert (actions.bincount(minlength=3) - 1000 / 3).abs().max() < 90
    train(agent, 1, batch=50)
    assert not torch.equal(before["action.eta"], agent.state_dict()["action.eta"])


@pytest.mark.parametrize(
    ("task", "critic"),
    [
        (PredatorPrey(observations="bipolar"), TableCritic(5.0)),
        (PredatorPrey(observations="bipolar"), NetworkCritic(memory=20, steps=2)),
        (Frames(), NetworkCritic(memory=20)),
    ],
    ids=["table", "network", "unknown states"],
)
def test_a_critic_resumes_bit_by_bit(task, critic, tmp_path):
    own = {"task": task, "exploration": Exploration(0.5, 25, 5), "cooling": Cooling(4.0, 20)}
    through = make_agent(critic=critic, **own)
    fit(through, tmp_path, max_epochs=3)
    callback = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=13)
    cut = {"callbacks": [callback], "enable_checkpointing": True, "max_steps": 13}
    fit(make_agent(critic=critic, **own), tmp_path, max_epochs=3, **cut)
    resumed = make_agent(critic=critic, seed=4, **own)
    fit(resumed, tmp_path, ckpt_path=tmp_path / "cut.ckpt", max_epochs=3)
    assert resumed.updates == 30
    assert_same_state(resumed, through)
    loaded = Agent.load_from_checkpoint(tmp_path / "cut.ckpt")
    signals = task.sample(7, torch.Generator()).observation
    assert loaded.update_rule.critic(signals).shape == (7, task.action_space.n)
    assert loaded.update_rule.exploration == own["exploration"]


def test_a_critic_belongs_to_one_agent():
    rule = Projection(critic=TableCritic(5.0))
    one, other = make_agent(update_rule=rule), make_agent(update_rule=rule)
    train(one, 5)
    assert one.update_rule.critic.count.sum() == 5
    assert other.update_rule.critic.count.sum() == 0
    weights = [make_agent(critic=NetworkCritic(), seed=s).update_rule.critic for s in (0, 0, 1)]
    first, same, another = (critic.network.layers[0].weight for critic in weights)
    assert torch.equal(first, same)
    assert not torch.equal(first, another)


def test_the_critics_error_is_logged(tmp_path):
    agent = make_agent(critic=TableCritic(5.0))
    trainer = fit(agent, tmp_path, max_epochs=1, callbacks=[InformationMonitor()])
    assert trainer.callback_metrics["critic/rmse"] == agent.update_rule.critic.rmse > 0


def test_a_noisy_sensor_is_learnt_from_single_encounters():
    # Û and channels from remembered triplets; the optimum of the two states without noise is 1.43.
    task = Frames()
    exploration = Exploration(share=0.3, updates=200, uniform_updates=60)
    critic = NetworkCritic(hidden=[32], start=1.0, memory=1000, lr=0.01)
    agent = make_agent(task, critic, exploration, beta_perception=6.0, beta_action=6.0)
    train(agent, 300)
    reached = agent.evaluate()
    table = TableTask(UTILITIES, observations="index")
    from bra.blahut_arimoto import serial

    optimum = serial(table.utilities, None, 4, 6.0, 6.0).objective
    assert reached.objective > optimum - 0.05


class Parts(torch.nn.Module):
    """What an update changes, as one module."""

    def __init__(self, agent):
        super().__init__()
        self.perception, self.action = agent.perception, agent.action
        self.rule, self.marginals = agent.update_rule, agent.marginals

    def forward(self, task, state, observation, beta):
        chain = Chain(task, self.perception, self.action, self.marginals, beta, beta)
        return self.rule.loss(chain, World(state, observation))[0]


@pytest.mark.parametrize(
    ("task", "critic"),
    [
        (PredatorPrey(observations="bipolar"), TableCritic(5.0)),
        (Frames(), NetworkCritic(hidden=[8], memory=9, steps=2)),
        (Frames(), None),
    ],
)
def test_a_population_learns_under_vmap(task, critic):
    parts = [Parts(make_agent(task, critic, seed=seed)) for seed in range(3)]
    weights, buffers = torch.func.stack_module_state(parts)
    trained = {name: value for name, value in weights.items() if value.requires_grad}

    def loss(weights, buffers, state, observation, beta):
        arguments = (task, state, observation, beta)
        return torch.func.functional_call(parts[0], (weights, buffers), arguments)

    for update in range(4):
        world = task.sample(6, torch.Generator().manual_seed(update))
        state, observation = world.state.view(3, 2), world.observation.view(3, 2, -1)
        together = torch.func.vmap(loss, randomness="different")
        losses = together(weights, buffers, state, observation, torch.tensor([1.0, 2.0, 3.0]))
        gradients = torch.autograd.grad(losses.sum(), list(trained.values()))
        assert all(part.isfinite().all() and part.flatten(1).any(1).all() for part in gradients)
    for name, value in buffers.items():
        if name.endswith("critic.count"):
            assert value.sum((1, 2)).tolist() == [8, 8, 8]
        if name.endswith("written"):
            assert value.tolist() == [8, 8, 8]
