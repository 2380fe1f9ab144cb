"""Optima of continuous states and actions, on grids."""

import math

import pytest
import torch
from gaussian_chain import Chase, best_linear

from bra import TableTask
from bra.blahut_arimoto import discretised, serial
from bra.tasks import TargetTask


def test_the_gaussian_chain_does_better_than_linear_channels():
    found = discretised(Chase().grid, None, 5.0, 5.0)
    assert found.converged
    assert found.error <= 1e-3
    assert found.optimum.objective == pytest.approx(-0.578, abs=2e-3)
    assert best_linear(5, 5)[0] < found.optimum.objective < -0.522  # that of one channel


def test_below_the_critical_prices_nothing_is_known():
    found = discretised(Chase().grid, 4, 1.0, 1.0)
    assert found.optimum.objective == pytest.approx(-1.0, abs=2 * found.error + 1e-9)
    assert found.optimum.perception_information == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("percepts", [2, None])
def test_two_targets_where_information_costs_next_to_nothing(percepts):
    free = discretised(TargetTask([[-1.0], [1.0]]).grid, percepts, 1e4, 1e4)
    assert free.optimum.objective == pytest.approx(-2 * math.log(2) / 1e4, abs=1e-6)


def test_the_error_covers_what_a_finer_grid_finds():
    task = TargetTask([[0.0], [1.0], [3.2], [3.9]], prior=[0.4, 0.3, 0.2, 0.1])
    found = discretised(task.grid, 4, 5.0, 5.0)
    finer = serial(*task.grid(301), 4, 5.0, 5.0, restarts=16, budget=32)
    assert abs(finer.objective - found.optimum.objective) <= 2 * found.error


def test_without_enough_points_it_has_not_converged():
    found = discretised(Chase().grid, 3, 20.0, 20.0, restarts=4, tolerance=1e-6)
    assert not found.converged
    assert found.points == 60


def test_tasks_without_grids():
    assert TargetTask([[0.0] * 4, [1.0] * 4]).grid(5) is None
    assert TableTask([[1.0, 0.0]]).grid(5) is None
    utilities, prior = TargetTask([[0.0, 0.0], [1.0, 2.0]]).grid(3)
    assert utilities.shape == (2, 9)
    assert prior.tolist() == [0.5, 0.5]
    assert utilities.dtype == torch.double
