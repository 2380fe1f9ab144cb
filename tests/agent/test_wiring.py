"""Every pair of channels whose spaces fit trains, both of them."""

import math
from functools import partial
from itertools import product

import lightning.pytorch as pl
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra import Agent
from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.tasks import FiniteTask, RolloutDataModule, TargetTask
from bra.update_rules import ExactGradient, ScoreFunction

IMAGES = torch.rand(4, 1, 3, 3, generator=torch.Generator().manual_seed(0))
PERCEPTS = {"3 percepts": Discrete(3), "2 numbers": Box(-np.inf, np.inf, (2,), np.float32)}
PERCEPTIONS = {
    "mlp": (partial(MLP, hidden=[8]), IMAGES),
    "cnn": (partial(CNN, channels=[4]), IMAGES),
    "table": (Table, "index"),
    "multinomial": (Multinomial, "index"),
    "gaussian": (Gaussian, "index"),
}
ACTIONS = {"table": Table, "multinomial": Multinomial, "mlp": MLP, "gaussian": Gaussian}
TASKS = {
    "decide": partial(FiniteTask, torch.eye(4), prior=[0.4, 0.3, 0.2, 0.1]),
    "aim": partial(TargetTask, [[0.0, 1.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 2.0]]),
}


def fits(perception, percepts, action, task):
    makes = {"table": Discrete, "multinomial": Discrete, "gaussian": Box}
    takes = {"table": Discrete, "multinomial": Discrete, "gaussian": Discrete}
    acts = Discrete if task == "decide" else Box
    space = type(PERCEPTS[percepts])
    return (
        makes.get(perception, space) is space
        and takes.get(action, space) is space
        and makes.get(action, acts) is acts
    )


def train(agent, updates=5):
    data = RolloutDataModule(agent.task, batch_size=32, updates_per_epoch=updates)
    trainer = pl.Trainer(
        max_epochs=1,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(agent, data)
    return trainer


def numbers(terms):
    return [float(value) for value in vars(terms).values() if value is not None]


CASES = [case for case in product(PERCEPTIONS, PERCEPTS, ACTIONS, TASKS) if fits(*case)]


def test_the_table_is_complete():
    # Discrete percepts: mlp, cnn, table, multinomial × table, multinomial, mlp twice, gaussian.
    # Numbers: mlp, cnn, gaussian × mlp twice.
    assert len(CASES) == 4 * 5 + 3 * 2


@pytest.mark.parametrize(("perception", "percepts", "action", "task"), CASES)
def test_every_pair_of_channels_trains(monkeypatch, perception, percepts, action, task):
    # Evaluating density after density takes the square of this.
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 256)
    factory, observations = PERCEPTIONS[perception]
    agent = Agent(
        TASKS[task](observations=observations),
        factory,
        ACTIONS[action],
        percepts=PERCEPTS[percepts],
        beta_perception=2.0,
        beta_action=3.0,
        update_rule=ScoreFunction(),
        seed=0,
    )
    before = {name: value.detach().clone() for name, value in agent.named_parameters()}
    trainer = train(agent)

    assert agent.updates == trainer.global_step == 5
    assert agent.samples == 5 * 32
    after = dict(agent.named_parameters())
    assert {name.partition(".")[0] for name in after} == {"perception", "action"}
    assert all(not torch.equal(before[name], after[name]) for name in after)
    assert all(value.isfinite().all() for value in after.values())
    assert len(numbers(agent.terms)) == 4
    assert all(map(math.isfinite, numbers(agent.terms)))

    terms = agent.evaluate()
    estimated = terms.standard_error is not None
    assert len(numbers(terms)) == 5 + estimated
    assert all(map(math.isfinite, numbers(terms)))
    # Information of four states, up to rounding and Monte Carlo normalisation.
    for name in ("perception_information", "end_to_end_information"):
        assert -1e-9 <= getattr(terms, name) <= math.log(4) + 1e-6


@pytest.mark.parametrize("perception", ["mlp", "cnn", "table"])
def test_exact_gradient_climbs(perception):
    factory, observations = PERCEPTIONS[perception]
    agent = Agent(
        TASKS["decide"](observations=observations),
        factory,
        Table,
        percepts=3,
        beta_perception=5.0,
        beta_action=5.0,
        update_rule=ExactGradient(),
        seed=0,
    )
    before = agent.evaluate().objective
    train(agent)
    after = agent.evaluate()
    assert after.objective > before


def test_training_is_a_function_of_the_seed():
    def trained(noise, seed):
        torch.manual_seed(noise)
        agent = Agent(TASKS["decide"](observations="index"), Table, Table, percepts=3, seed=seed)
        train(agent)
        return torch.cat([value.detach().flatten() for value in agent.parameters()])

    assert torch.equal(trained(noise=1, seed=0), trained(noise=2, seed=0))
    assert not torch.equal(trained(noise=1, seed=0), trained(noise=1, seed=1))
