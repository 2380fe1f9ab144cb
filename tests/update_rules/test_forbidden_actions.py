"""Actions of utility −inf: probabilities fall to zero, J and gradients stay finite."""

import functools
import math

import lightning.pytorch as pl
import pytest
import torch

from bra import Agent
from bra.blahut_arimoto import serial
from bra.channels import Table
from bra.critics import TableCritic
from bra.tasks import RolloutDataModule, TableTask
from bra.update_rules import ExactGradient, Projection, ScoreFunction

FORBIDDEN = -math.inf
TABLE = [
    [FORBIDDEN, FORBIDDEN, 0.0, 0.1],
    [0.8, FORBIDDEN, 0.6, 0.7],
    [0.5, 0.9, 0.8, FORBIDDEN],
    [FORBIDDEN, 0.1, 0.7, FORBIDDEN],
]


@pytest.mark.parametrize(
    "rule",
    [
        ExactGradient(),
        Projection(),
        Projection(critic=TableCritic(start=1.0)),
        ScoreFunction(samples=8, baseline="leave-one-out"),
    ],
    ids=["exact", "projection", "critic", "score"],
)
def test_agents_learn_not_to_take_them(rule):
    pl.seed_everything(0, verbose=False)
    task = TableTask(TABLE, observations="index")
    adam = functools.partial(torch.optim.Adam, lr=0.1)
    agent = Agent(task, Table, Table, 4, 6.0, 6.0, rule, adam, adam)
    barred = task.utilities.isneginf()
    before = agent.evaluate().objective
    assert math.isfinite(before)
    assert agent.behaviour()[barred].max() > 0.1
    trainer = pl.Trainer(
        max_epochs=1,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(agent, datamodule=RolloutDataModule(task, updates_per_epoch=300, batch_size=16))
    assert all(parameter.isfinite().all() for parameter in agent.parameters())
    assert agent.behaviour()[barred].max() < 1e-3
    optimum = serial(task.utilities, task.prior, 4, 6.0, 6.0)
    assert optimum.action_given_state[barred].max() == 0
    assert optimum.objective - 0.05 < agent.evaluate().objective <= optimum.objective + 1e-6
