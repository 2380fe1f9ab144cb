"""Rate–distortion functions that textbooks give (Cover & Thomas 2006, chapter 10)."""

import math

import pytest
import torch

from bra.blahut_arimoto import at_rate, rate_distortion


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
