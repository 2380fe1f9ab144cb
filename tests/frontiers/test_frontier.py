"""Rate–utility curves."""

import math
import sys
from importlib import import_module
from types import SimpleNamespace

import pytest
import torch

import bra
from bra.blahut_arimoto import rate_distortion, serial
from bra.frontiers.picture import draw_frontier
from bra.tasks import PredatorPrey, TableTask


@pytest.fixture(scope="module")
def curve():
    return bra.frontier(PredatorPrey(), 1.0, 2.0, percepts=6, points=8)


def test_points_are_the_optima_at_their_prices(curve):
    assert torch.allclose(curve.beta_action, 2 * curve.beta_perception)
    task = PredatorPrey()
    for index in (0, 5, -1):
        prices = curve.beta_perception[index].item(), curve.beta_action[index].item()
        found = serial(task.utilities, task.prior, 6, *prices, restarts=8)
        assert curve.objective[index].item() == pytest.approx(found.objective, abs=1e-9)
        assert curve.upper_bound[index].item() == pytest.approx(found.tight_bound, abs=1e-9)


def test_rows_are_what_pandas_gets(curve, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows: ("df", rows)))
    assert curve.to_pandas() == ("df", curve.rows())
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pandas"):
        curve.to_pandas()


def test_more_is_earned_with_more_information(curve):
    """The two informations together, each at its share of the price."""
    information = curve.perception_information + curve.action_information / 2
    assert (curve.expected_utility.diff() > -1e-7).all()
    assert (information.diff() > -1e-7).all()
    assert curve.end_to_end_information[0] == 0
    assert curve.expected_utility[-1] == pytest.approx(3.6, abs=2e-3)


def test_the_bound_of_utilities_is_that_of_the_rates(curve):
    """No curve of one channel passes it, which earns at least as much at the same rates."""
    assert (curve.utility_bound >= curve.expected_utility).all()
    task = PredatorPrey()
    single = rate_distortion(task.utilities, task.prior, 2.0)
    rate, earned = single.end_to_end_information, single.expected_utility
    both = torch.maximum(curve.perception_information, curve.action_information)
    below = both <= rate
    assert (curve.expected_utility[below] <= earned).all()


def test_behaviour_changes_where_two_optima_are_as_good(curve):
    changes = [index for index, text in enumerate(curve.change) if text]
    assert curve.change[changes[0]].startswith("information becomes worth its price")
    for index in changes:
        assert curve.beta_perception[index] / curve.beta_perception[index - 1] < 1 + 2e-3
        assert curve.objective[index] - curve.objective[index - 1] < 5e-3
        assert curve.percepts[index] != curve.percepts[index - 1]
    assert (curve.beta_perception.diff() > 0).all()


@pytest.mark.parametrize("ratio", [1.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_the_critical_price_of_a_binary_choice_is_known(ratio):
    """Information becomes worth it at β₁β₂ = n², n = 2, without a jump."""
    curve = bra.frontier(TableTask([[1.0, 0.0], [0.0, 1.0]]), 1.0, ratio, points=4, restarts=4)
    (index,) = (i for i, text in enumerate(curve.change) if text.startswith("information"))
    assert math.sqrt(curve.beta_perception[index] * curve.beta_action[index]) == pytest.approx(
        2.0, rel=3e-3
    )


def test_alternatives_are_considered_from_known_prices_on():
    """Caplin, Dean & Leahy (2019): number k from e^β = Σ_{j<k} μ(j)/μ(k) − k + 2 on."""
    prior = torch.tensor([0.5, 0.3, 0.15, 0.05])
    known = [(prior[:k].sum() / prior[k] - k + 1).log().item() for k in (1, 2, 3)]
    task = TableTask(torch.eye(4), prior)
    curve = bra.frontier(task, 1.0, 1e6, points=6, restarts=4)
    changed = torch.tensor([bool(text) for text in curve.change])
    assert curve.beta_perception[changed].tolist() == pytest.approx(known, rel=3e-3)
    assert [text[-10:] for text in curve.change if text] == [f"{k} percepts" for k in (2, 3, 4)]


def test_of_many_changes_the_first_dozen_is_located(monkeypatch):
    """Alternatives whose probabilities fall come one by one, as above."""
    prior = 0.7 ** torch.arange(12.0)
    task = TableTask(torch.eye(12), prior / prior.sum())
    known = [(prior[:k].sum() / prior[k] - k + 1).log().item() for k in range(1, 12)]
    monkeypatch.setattr(import_module("bra.frontiers.frontier"), "LOCATED", 2)
    curve = bra.frontier(task, 1.0, 1e6, points=6, restarts=2)
    changes = [index for index, text in enumerate(curve.change) if text]
    prices = curve.beta_perception[changes]
    assert prices[:2].tolist() == pytest.approx(known[:2], rel=3e-3)
    assert len(curve.change) == 6 + 2 * 2 and len(changes) < 12
    last = curve.percepts[changes[-1]]
    assert prices[-1] > known[last - 2] and curve.change[changes[-1]].endswith(f"{last} percepts")


def test_scaled_utilities_scale_the_prices():
    table = torch.tensor([[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]])
    plain, scaled = (
        bra.frontier(TableTask(factor * table + 5.0), points=4) for factor in (1.0, 1000.0)
    )
    torch.testing.assert_close(scaled.beta_perception, plain.beta_perception / 1000)
    torch.testing.assert_close(
        scaled.action_information, plain.action_information, atol=1e-6, rtol=0
    )


def test_percepts_of_rare_states_count():
    """A state of probability 1e-7 with a percept and an action of its own."""
    task = TableTask(torch.eye(3) * torch.tensor([1.0, 1.0, 1e7]), prior=[0.5, 0.4999999, 1e-7])
    curve = bra.frontier(task, points=4, restarts=1)
    assert curve.percepts[-1] == 3
    assert curve.expected_utility[-1] == pytest.approx(2.0, abs=2e-3)


def test_where_no_action_is_safe_the_curve_begins_with_information():
    table = torch.tensor([[1.0, 0.0, -math.inf], [-math.inf, 0.5, 1.0], [0.0, -math.inf, 1.0]])
    curve = bra.frontier(TableTask(table), points=6, restarts=8)
    assert (curve.end_to_end_information > 0.1).all()
    assert curve.beta_perception[0] == pytest.approx(1.0)
    assert curve.expected_utility[-1] == pytest.approx(1.0, abs=2e-3)


def test_rows_are_tidy(curve):
    rows = curve.rows()
    assert len(rows) == len(curve.objective) and rows[0]["kind"] == "optimum"
    for row in rows:
        nats = row["perception_information_nats"]
        assert row["perception_information_bits"] == pytest.approx(nats / math.log(2))


def test_a_grid_has_all_pairs():
    grid = bra.frontier(TableTask([[1.0, 0.0], [0.0, 1.0]]), points=3, grid=True, restarts=2)
    pairs = set(zip(grid.beta_perception.tolist(), grid.beta_action.tolist(), strict=True))
    assert len(pairs) == 9
    assert len(draw_frontier(grid).axes) == 6  # three maps and their scales


def test_agents_are_drawn_beside_the_optimum(curve):
    names = ("expected_utility", "perception_information", "action_information")
    agents = {name: getattr(curve, name)[:2] for name in (*names, "end_to_end_information")}
    figure = draw_frontier(curve, agents)
    assert [axes.get_xlabel()[:6] for axes in figure.axes] == ["I(Ω;X)", "I(X;A)", "I(Ω;A)"]
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels == ["certified bound", "optimum", "percepts come or go", "agents"]


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"task": TableTask([[2.0, 1.0], [3.0, 0.0]])}, "one action is best in every state"),
        ({"points": 0}, "points must be a whole number of at least 1"),
        ({"points": 10**13}, "points 10,000,000,000,000 would take more than"),
        ({"grid": "yes"}, "grid must be true or false, got 'yes'"),
        ({"beta_action": -1.0}, "beta_action must be positive"),
        ({"percepts": 1}, "a frontier needs two percepts or more"),
        ({"percepts": 0}, "percepts must be a whole number of at least 1"),
    ],
)
def test_what_has_no_frontier_says_why(own, message):
    with pytest.raises(ValueError, match=message):
        bra.frontier(**({"task": PredatorPrey()} | own))


def test_a_frontier_is_of_a_task():
    with pytest.raises(TypeError, match="task must be of class FiniteTask, got 'hunt'"):
        bra.frontier("hunt")
