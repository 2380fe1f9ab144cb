"""Blocks of whatever can be compiled are the updates that they stand for."""

import logging
from functools import partial

import pytest
import torch
from block_runs import SETTINGS, Looks, fit
from gymnasium.spaces import Box, Discrete
from torch.optim import SGD, Adam, AdamW
from torch.optim.lr_scheduler import CosineAnnealingLR, LambdaLR, LinearLR, StepLR

from bra import Agent, Cooling, Population, TableTask
from bra.channels import CNN, MLP, Table
from bra.checkpoints import Rebuildable
from bra.critics import Exploration, NetworkCritic, TableCritic
from bra.marginals import BatchMarginals, RunningMarginals
from bra.tasks import FiniteTask, Medical, Task, World
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction


def assert_blocks_are_updates(
    folder, caplog, kind=Agent, atol=1e-9, updates=40, batch_size=3, **own
):
    """In float64, so that rounding tips no draw."""
    caplog.set_level(logging.INFO, "bra")
    torch.set_default_dtype(torch.float64)
    try:
        eager, compiled = (
            kind(**(SETTINGS | own | {"compile": c})).double() for c in (False, True)
        )
        fit(eager, folder, updates, batch_size)
        looks = Looks(None)
        fit(compiled, folder, updates, batch_size, callbacks=[looks])
    finally:
        torch.set_default_dtype(torch.float32)
    assert "one by one" not in caplog.text
    assert len(looks.seen) <= 4 and looks.seen[-1] == 2 * updates
    assert (compiled.updates, compiled.samples) == (eager.updates, eager.samples)
    for name, tensor in eager.state_dict().items():
        torch.testing.assert_close(tensor, compiled.state_dict()[name], rtol=atol, atol=atol)
    torch.testing.assert_close(eager.terms.objective, compiled.terms.objective)


RULES = {
    "projection": Projection(),
    "rivals": Projection(rivals=Rivals(count=4, sweeps=5, lead=40)),
    "exact gradient": ExactGradient(),
    "leave-one-out": ScoreFunction(3, "leave-one-out"),
    "online": ScoreFunction(),
}


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("kind", ["agent", "population"])
def test_rules(tmp_path, caplog, rule, kind):
    own = {"update_rule": RULES[rule], "cooling": Cooling(4.0, 60)}
    if kind == "population":
        own |= {"kind": Population, "replicas": 3, "beta_action": [10.0, 2.0]}
    assert_blocks_are_updates(tmp_path, caplog, **own)


class Harmonic(Rebuildable):
    """1, 1/2, 1/3, …."""

    def __call__(self, update):
        return 1 / (1 + update)


OPTIMIZERS = {
    "momentum": (
        partial(SGD, lr=0.1, momentum=0.9, nesterov=True),
        partial(LinearLR, total_iters=30),
    ),
    "adam": (partial(Adam, lr=0.05), partial(LambdaLR, lr_lambda=Harmonic())),
    "adamw": (partial(AdamW, lr=0.05, amsgrad=True), partial(StepLR, step_size=7)),
    "decay": (partial(SGD, lr=0.1, weight_decay=0.01), partial(CosineAnnealingLR, T_max=80)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("kind", ["agent", "population"])
def test_optimizers_and_schedules(tmp_path, caplog, name, kind):
    optimizer, scheduler = OPTIMIZERS[name]
    own = {"perception_optimizer": optimizer, "perception_scheduler": scheduler}
    if kind == "population":
        own |= {"kind": Population, "replicas": 2, "perception_rate": [0.1, 0.02]}
    assert_blocks_are_updates(tmp_path, caplog, update_rule=Projection(), **own)


class Sensor(FiniteTask):
    """Points on a line, seen with noise."""

    def __init__(self):
        places = torch.linspace(-1, 1, 4)
        super().__init__(-(places[:, None] - places).square(), None, places[:, None])

    noiseless = False

    def observe(self, state, generator):
        noise = torch.randn(*state.shape, 1, generator=generator)
        return super().observe(state, generator) + 0.3 * noise


class Arm(Task):
    """States of many numbers, of which the signal shows one."""

    observation_space, action_space = Box(-1, 1, (1,)), Discrete(3)

    def sample(self, count, generator):
        state = torch.rand(count, 40, generator=generator)
        return World(state, 2 * state[:, :1] - 1)

    def utility(self, state, action):
        return (state[..., 0] * 2 - action).square().neg()


EXPLORING = Exploration(0.3, 40, uniform_updates=10)


OTHERS = {
    "batch marginals": {"marginals": BatchMarginals()},
    "running marginals": {"marginals": RunningMarginals(0.9), "update_rule": ScoreFunction()},
    "noisy sensor": {"task": Sensor(), "update_rule": Projection()},
    "images": {
        "task": TableTask(torch.eye(4), None, torch.rand(4, 1, 6, 6)),
        "perception": partial(CNN, channels=[2]),
    },
    "table critic": {"update_rule": Projection(critic=TableCritic(3.0), exploration=EXPLORING)},
    "network critic": {
        "task": Sensor(),
        "update_rule": Projection(
            critic=NetworkCritic(hidden=[6], memory=64), exploration=EXPLORING
        ),
    },
    "one number per row": {"task": TableTask(torch.eye(3), None, "index"), "perception": Table},
    "states of many numbers": {"task": Arm(), "batch_size": 60, "marginals": RunningMarginals(0.9)},
    "specialists": {
        "task": Medical(),
        "beta_direct": 0.9,
        "action": partial(MLP, hidden=[7]),
        "update_rule": Projection(),
        "cooling": Cooling(3.0, 50),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_marginals_sensors_and_critics(tmp_path, caplog, name):
    assert_blocks_are_updates(tmp_path, caplog, **OTHERS[name])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["norm", "value"])
def test_clipped_gradients(tmp_path, algorithm):
    agents = [Agent(**(SETTINGS | {"compile": compile})) for compile in (False, True)]
    for agent in agents:
        options = {"gradient_clip_val": 0.03, "gradient_clip_algorithm": algorithm}
        fit(agent, tmp_path, 20, **options)
    plain = Agent(**(SETTINGS | {"compile": False}))
    fit(plain, tmp_path, 20)
    for name, tensor in agents[0].state_dict().items():
        torch.testing.assert_close(tensor, agents[1].state_dict()[name], rtol=1e-4, atol=1e-5)
    assert not torch.allclose(plain.action.eta, agents[0].action.eta, atol=1e-3)


@pytest.mark.slow
def test_many_agents_have_room(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("bra.blocks.groups.ALIASED", 4)
    assert_blocks_are_updates(tmp_path, caplog, kind=Population, replicas=4)


@pytest.mark.slow
def test_groups_of_agents_go_one_after_the_other(tmp_path, caplog, monkeypatch):
    """The last one is smaller; what an optimizer counts for all counts once."""
    monkeypatch.setattr("bra.blocks.groups.GROUP", 2)
    own = {
        "perception_optimizer": partial(Adam, lr=0.01),
        "action_rate": [0.1, 0.2, 0.3, 0.4, 0.5],
        "beta_action": [2.0, 4.0, 6.0, 8.0, 10.0],
        "replicas": 1,
    }
    assert_blocks_are_updates(tmp_path, caplog, kind=Population, **own)
