"""What the monitors know and show."""

import io
import itertools
import json
import math
from functools import partial

import lightning.pytorch as pl
import pytest
import torch
from gymnasium.spaces import Box
from lightning.pytorch.callbacks.progress.tqdm_progress import Tqdm

from bra import Agent, Population, PredatorPrey, RolloutDataModule, TableTask
from bra.blahut_arimoto import rate_distortion
from bra.callbacks import (
    BaselineMonitor,
    BehaviourFigures,
    InformationMonitor,
    RunSummary,
    UpdateBar,
)
from bra.callbacks.baseline import solve_reference
from bra.callbacks.behaviour import Tables, behaviour_figures
from bra.callbacks.hits import hit_threshold, wilson
from bra.callbacks.population import population_rows
from bra.channels import MLP, Gaussian
from bra.pictures import draw_heatmap
from bra.tasks import TargetTask


def fit(agent, folder, *callbacks, updates=20):
    trainer = pl.Trainer(
        max_epochs=1,
        logger=False,
        callbacks=list(callbacks),
        default_root_dir=folder,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(agent, RolloutDataModule(agent.task, 8, updates))
    return trainer


def test_the_bar_shows_objective_and_gap(tmp_path):
    agent = Agent(PredatorPrey(), percepts=3, seed=0)
    baseline = BaselineMonitor(every_n_updates=7)
    trainer = fit(agent, tmp_path, InformationMonitor(every_n_updates=7), baseline)
    reached = agent.evaluate().objective
    assert trainer.progress_bar_metrics["J"] == reached
    assert trainer.progress_bar_metrics["gap"] == baseline.reference(agent).objective - reached


def test_the_bar_is_drawn_at_most_ten_times_a_second(tmp_path, monkeypatch):
    drawn, now = [], itertools.count(1.0, 0.03)
    monkeypatch.setattr("bra.callbacks.progress.time.monotonic", lambda: next(now))
    monkeypatch.setattr(Tqdm, "set_postfix", lambda bar, *_: drawn.append(bar.n))
    bar = UpdateBar()
    trainer = pl.Trainer(callbacks=[bar], logger=False, default_root_dir=tmp_path)
    agent = Agent(PredatorPrey(), percepts=3)
    bar.setup(trainer, agent, "fit")
    bar.train_progress_bar = Tqdm(total=20, file=io.StringIO())
    for number in range(20):
        trainer.fit_loop.epoch_loop.batch_progress.current.ready = number + 1
        bar.on_train_batch_end(trainer, agent, None, None, number)
    assert drawn == [1, 5, 9, 13, 17, 20]


def test_continuous_percepts_have_a_bound_and_no_optimum():
    task = PredatorPrey()
    percepts = Box(-math.inf, math.inf, (2,))
    agent = Agent(task, MLP, MLP, percepts, beta_perception=8.0, beta_action=10.0)
    reference = solve_reference(agent)
    bound = rate_distortion(task.utilities, task.prior, 80 / 18).upper_bound
    assert reference.optimum is None
    assert reference.upper_bound == pytest.approx(bound, abs=1e-12)
    assert agent.evaluate().objective < bound


@pytest.mark.parametrize("dimensions", [1, 4])
def test_a_task_without_a_table_has_an_optimum_if_it_has_grids(dimensions, tmp_path):
    task = TargetTask([[0.0] * dimensions, [1.0] * dimensions])
    agent = Agent(task, MLP, Gaussian, 2, beta_perception=5.0, beta_action=9.0, seed=0)
    fit(agent, tmp_path, BaselineMonitor(), RunSummary(), BehaviourFigures(), InformationMonitor())
    (path,) = tmp_path.rglob("summary.json")
    summary = json.loads(path.read_text())
    optimum, gap = summary["blahut_arimoto_objective"], summary["gap"]
    if dimensions == 1:
        assert gap == optimum - summary["objective"]
        assert 0 <= summary["blahut_arimoto_error"] < 1e-3
    else:
        assert optimum is gap is None
    assert summary["upper_bound"] is None
    assert summary["updates"] == 20
    assert math.isfinite(summary["objective"])


def test_figures_show_the_channels():
    agent = Agent(TableTask([[1.0, 0.0]] * 3), percepts=2, seed=0)
    figures = behaviour_figures(agent)
    evaluation = agent.evaluation()
    weights = agent.task.prior @ evaluation.percept_given_state
    percepts = [f"x{i} ({p:.2f})" for i, p in enumerate(weights.tolist())]
    title = f"after 0 updates\nJ = {evaluation.objective.objective:.4f}"
    states, actions = agent.task.state_names, agent.task.action_names
    expected = {
        "p_action_given_state": (agent.behaviour(), states, actions, "p(a|ω)"),
        "p_percept_given_state": (evaluation.percept_given_state, states, ["x0", "x1"], "p(x|ω)"),
        "p_action_given_percept": (
            *(evaluation.action_given_percept, percepts, actions, "p(a|x) and (p(x))"),
        ),
    }
    assert figures == {
        name: draw_heatmap(table.numpy(), rows, columns, f"{symbol} {title}")
        for name, (table, rows, columns, symbol) in expected.items()
    }
    large = Agent(TableTask(torch.rand(80, 2)), percepts=2)
    assert set(behaviour_figures(large)) == {"p_action_given_percept"}


def test_percepts_of_the_optimum_come_in_the_order_of_the_agents():
    prior = torch.tensor([0.5, 0.3, 0.2], dtype=torch.double)
    percepts = torch.tensor([[0.9, 0.1, 0.0], [0.0, 0.2, 0.8], [0.1, 0.9, 0.0]]).double()
    actions = torch.tensor([[1.0, 0.0], [0.3, 0.7], [0.0, 1.0]]).double()
    looks = torch.rand(3, 3, 2).double()
    own = Tables(percepts, actions, prior @ percepts, percepts @ actions, looks)
    order = [2, 0, 1]
    turned = (percepts[:, order], actions[order], own.percept[order])
    other = Tables(*turned, own.action_given_state, looks[order])
    found = other.like(own, prior)
    for name, table in vars(own).items():
        assert torch.equal(getattr(found, name), table)


@pytest.mark.parametrize(
    "make",
    [InformationMonitor, BehaviourFigures, partial(BaselineMonitor, 8)],
)
def test_intervals_are_at_least_one_update(make):
    with pytest.raises(ValueError, match="every_n_updates must be a whole number of at least 1"):
        make(every_n_updates=0)


def test_monitors_refuse_other_modules():
    with pytest.raises(TypeError, match=r"monitors watch a bra.Agent, got LightningModule"):
        InformationMonitor().on_train_start(pl.Trainer(logger=False), pl.LightningModule())


@pytest.mark.parametrize("unit", [0.004, 1.0, 400.0])
def test_a_hit_means_the_same_in_every_unit(unit):
    forbidden = [[1.0, 0.0, -math.inf], [0.0, 1.0, 0.5]]
    task = TableTask(unit * torch.tensor(forbidden, dtype=torch.double))
    assert task.utility_range == pytest.approx(unit)
    assert hit_threshold(task) == pytest.approx(0.005 * unit)


def test_a_table_of_agents_has_the_same_columns_whatever_is_known():
    population = Population(PredatorPrey(), replicas=2, percepts=3, seed=0)
    first, _ = population_rows(population, None)
    assert first["gap"] is None and first["state_information_nats"] is None
    assert first["objective"] == population.objectives()[0].item()
    assert {"end_to_end_information_nats", "seed", "beta_perception"} < first.keys()


@pytest.mark.parametrize(
    ("count", "trials", "expected"),
    [  # the ends solve (p̂ − p)² = z² p (1 − p) / n
        (0, 10, (0.0, 0.27753)),
        (10, 10, (0.72247, 1.0)),
        (3, 4, (0.30064, 0.95441)),
    ],
)
def test_wilsons_interval(count, trials, expected):
    found = wilson(count, trials)
    assert found == pytest.approx(expected, abs=1e-5)
    for end in found:
        if 1e-9 < end < 1 - 1e-9:
            chi = (count / trials - end) ** 2 * trials / (end * (1 - end))
            assert chi == pytest.approx(1.959964**2, abs=1e-6)
