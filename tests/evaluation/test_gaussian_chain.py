"""Continuous channels end to end: trained linear Gaussians reach the best of their kind."""

import math
from functools import partial

import pytest
import torch
from gaussian_chain import LINE, Chase, Linear, best_linear, linear_objective
from torch.optim import Adam
from torch.optim.lr_scheduler import LinearLR
from training import make_trainer

from bra import Agent, RolloutDataModule
from bra.randomness import counted_generator
from bra.update_rules import ScoreFunction


def train(prices, updates, folder, rate=0.02, batch_size=64, slope=1.0, seed=0):
    optimizer = partial(Adam, lr=rate)
    fall = partial(LinearLR, start_factor=1.0, end_factor=0.02, total_iters=updates)
    channel = partial(Linear, slope=slope)
    agent = Agent(
        Chase(),
        channel,
        channel,
        LINE,
        *prices,
        update_rule=ScoreFunction(4, "leave-one-out"),
        perception_optimizer=optimizer,
        action_optimizer=optimizer,
        perception_scheduler=fall,
        action_scheduler=fall,
        seed=seed,
    )
    trainer = make_trainer(folder, max_epochs=1, limit_val_batches=0)
    trainer.fit(agent, RolloutDataModule(agent.task, batch_size, updates))
    return agent


def test_the_closed_form():
    assert best_linear(5, 5) == pytest.approx((-0.649304, 0.887298, 0.887298), abs=1e-6)
    assert best_linear(8, 3)[0] == pytest.approx(-0.689183, abs=1e-6)
    # The first-order jump at β₁ = β₂ = 2.45541, where u falls from 0.71533.
    assert best_linear(2.4554, 2.4554)[1] == 0
    assert best_linear(2.45542, 2.45542)[1] == pytest.approx(0.71533, abs=1e-4)


def test_the_closed_form_is_stationary_for_channels_that_attain_it():
    objective, u, v = best_linear(8, 3)
    agent = Agent(Chase(), Linear, Linear, LINE, 8.0, 3.0, update_rule=ScoreFunction(), seed=0)
    slopes, scales = (1.0, u * v), (math.sqrt((1 - u) / u), math.sqrt(u * v * (1 - v)))

    def value(*changes):
        channels = (agent.perception, agent.action)
        for c, slope, scale, change in zip(channels, slopes, scales, changes, strict=True):
            c.slope.data.fill_(slope + change)
            c.log_scale.data.fill_(math.log(scale - 1e-3))
        return linear_objective(agent)[0]

    assert value(0.0, 0.0) == pytest.approx(objective, abs=1e-6)
    for change in ((0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)):
        assert objective - 1e-3 < value(*change) < objective


def test_trained_channels_come_close(tmp_path, prices=(8.0, 3.0)):
    agent = train(prices, 250, tmp_path)
    assert linear_objective(agent)[0] == pytest.approx(best_linear(*prices)[0], abs=3e-3)


def test_below_the_critical_price_they_stay_silent(tmp_path):
    agent = train((1.0, 1.0), 250, tmp_path, slope=0.2)
    _, first, second = linear_objective(agent)
    assert max(first, second) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("prices", [(5.0, 5.0), (8.0, 3.0)])
def test_trained_channels_reach_the_best_within_the_standard_error(prices, tmp_path):
    agent = train(prices, 1500, tmp_path, batch_size=256)
    exact, *_ = linear_objective(agent)
    assert exact == pytest.approx(best_linear(*prices)[0], abs=5e-4)
    generator = counted_generator(0, 0, "worlds of a test")
    worlds = [agent.task.sample(1024, generator) for _ in range(32)]
    found = torch.tensor([agent.evaluation(world).objective.objective for world in worlds])
    error = (found.std() / math.sqrt(len(found))).item()
    assert error < 0.02
    # Information over 1024 worlds is low by O(1/N), which J gains.
    assert abs(found.mean().item() - best_linear(*prices)[0]) < 4 * error + 0.005
