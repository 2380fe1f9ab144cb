"""Rate–distortion functions that textbooks give (Cover & Thomas 2006, chapter 10)."""

import math
from importlib import import_module

import pytest
import torch

from bra.blahut_arimoto import at_rate, rate_distortion, serial

climb_module = import_module("bra.blahut_arimoto.climb")


def entropy(p):
    return -p * math.log2(p) - (1 - p) * math.log2(1 - p)


@pytest.mark.parametrize(("ones", "distortion"), [(0.5, 0.1), (0.3, 0.1), (0.11, 0.05)])
def test_bernoulli_with_hamming_distortion(ones, distortion):
    """R(D) = h(p) − h(D), of slope log((1 − D)/D)."""
    rate = entropy(ones) - entropy(distortion)
    found = at_rate([[0.0, -1.0], [-1.0, 0.0]], [1 - ones, ones], bits=rate)
    assert -found.expected_utility == pytest.approx(distortion, abs=1e-8)
    assert found.upper_bound - found.expected_utility < 1e-8
    assert found.beta == pytest.approx(math.log((1 - distortion) / distortion), rel=1e-4)


def test_equal_letters_with_hamming_distortion():
    """R(D) = log m − h(D) − D log(m − 1)."""
    rate = math.log2(6) - entropy(0.2) - 0.2 * math.log2(5)
    assert -at_rate(torch.eye(6) - 1, None, bits=rate).expected_utility == pytest.approx(0.2)


def test_erasures():
    """What must not be wrong may be left out: R(D) = 1 − D."""
    table = [[0.0, -math.inf, -1.0], [-math.inf, 0.0, -1.0]]
    assert -at_rate(table, None, bits=0.7).expected_utility == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("bits", [0.5, 1.0, 2.0])
def test_normal_numbers_with_squared_error(bits):
    """D(R) = σ² 2^(−2R), but for the grid."""
    points = torch.linspace(-5, 5, 101, dtype=torch.float64)
    error = (points[:, None] - points).square()
    found = at_rate(-error, (-points.square() / 2).softmax(0), bits=bits)
    assert -found.expected_utility == pytest.approx(2 ** (-2 * bits), rel=1e-3)


def test_a_duplicate_takes_nothing_from_others():
    """Matějka & McKay (2015): a second bus of the same payoffs leaves the car what it was."""
    table = torch.tensor([[0.0, 1.0], [1.0, 0.0]], dtype=torch.float64)
    single = rate_distortion(table, None, 2.0)
    double = rate_distortion(table[:, [0, 1, 1]], None, 2.0)
    torch.testing.assert_close(double.action_given_state[:, 0], single.action_given_state[:, 0])
    assert double.objective == pytest.approx(single.objective, abs=1e-12)


@pytest.mark.parametrize("beta", [pytest.param(5.0, marks=pytest.mark.slow), 20.0])
def test_quantities_that_are_told_too_small_at_most(monkeypatch, beta):
    """An exponential quantity and one-sided distortion (Verdú 1996); no climb gets stuck or lost.

    State 0 allows one action alone; most percepts fade to where marginals are known to ε |log p|.
    """
    climbs, climb = [], climb_module.climb
    monkeypatch.setattr(climb_module, "climb", lambda *a: climbs.append(climb(*a)) or climbs[-1])
    sizes = torch.linspace(0, 8, 81, dtype=torch.float64)
    short = sizes[:, None] - sizes
    utilities, prior = torch.where(short < -1e-9, -math.inf, -short), (-sizes).softmax(0)
    found = serial(utilities, prior, 81, beta, 1e6 * beta, budget=32)
    assert climbs and all(end.converged.all() for end in climbs)
    single = rate_distortion(utilities, prior, beta)
    assert found.objective == pytest.approx(single.objective, abs=1e-4)
    assert single.gap < 1e-10 and found.objective < single.upper_bound + 1e-12
