"""What one channel earns at a given rate."""

import math

import pytest
import torch

from bra.blahut_arimoto import at_rate, rate_distortion
from bra.information import mutual_information

LN2 = math.log(2)
IDENTITY = 0.2 + 0.6 * torch.eye(3, dtype=torch.float64)
SAFE = [[1.0, 0.0, 0.8], [0.0, 1.0, 0.8]]
"""A safe action, which is given up for a choice of two: by mixing, not bit by bit."""


@pytest.mark.parametrize(
    ("utilities", "prior", "bits", "earned", "digits"),
    [
        (IDENTITY, None, 1.0561, 0.7457, 1e-4),  # Lai & Gershman 2021, at β = 5
        (IDENTITY, [0.6, 0.2, 0.2], 0.8421, None, 1e-4),
        ([[1, 0.5, 0], [1, 0.5, 0], [0.5, 0, 1]], None, 0.6081, 0.9688, 1e-4),
    ],
)
def test_published_rates(utilities, prior, bits, earned, digits):
    found = at_rate(utilities, prior, bits)
    at_price = rate_distortion(utilities, prior, 5.0)
    assert found.end_to_end_information == pytest.approx(bits * LN2, abs=1e-9)
    assert found.beta == pytest.approx(5.0, rel=2e-3)
    assert found.expected_utility == pytest.approx(at_price.expected_utility, abs=digits)
    if earned is not None:
        assert found.expected_utility == pytest.approx(earned, abs=digits)


def test_a_binary_choice_is_that_of_the_binary_symmetric_channel():
    """E[U] = 1 − e with R = 1 − h(e) bits, h the binary entropy."""
    for error in (0.5, 0.3, 0.11, 0.01):
        entropy = -(error * math.log2(error) + (1 - error) * math.log2(1 - error))
        found = at_rate([[1.0, 0.0], [0.0, 1.0]], None, 1 - entropy)
        assert found.expected_utility == pytest.approx(1 - error, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_value_and_bound_are_one(seed):
    generator = torch.Generator().manual_seed(seed)
    states, actions = torch.randint(2, 12, (2,), generator=generator).tolist()
    utilities = torch.randn(states, actions, generator=generator, dtype=torch.float64)
    prior = torch.rand(states, generator=generator, dtype=torch.float64)
    prior /= prior.sum()
    for bits in (0.0, 0.1, 0.7, 10.0):
        found = at_rate(utilities, prior, bits)
        channel = found.action_given_state
        assert found.end_to_end_information <= bits * LN2 + 1e-12
        assert mutual_information(prior, channel).item() == pytest.approx(
            found.end_to_end_information, abs=1e-12
        )
        earned = (prior @ (channel * utilities).sum(-1)).item()
        assert found.expected_utility == pytest.approx(earned, abs=1e-9)
        assert 0 <= found.upper_bound - found.expected_utility + 1e-12 <= 1e-8


def test_between_two_rates_without_a_price_their_mixture_is_best():
    ends = at_rate(SAFE, None, 0.1).jump
    assert ends is not None
    low, high = ends
    assert low == pytest.approx(0.0, abs=1e-4)
    middle = at_rate(SAFE, None, (low + high) / 2 / LN2)
    outer = [at_rate(SAFE, None, rate / LN2).expected_utility for rate in ends]
    assert middle.jump == pytest.approx(ends, abs=1e-4)
    assert middle.expected_utility == pytest.approx(sum(outer) / 2, abs=1e-5)
    assert middle.upper_bound == pytest.approx(middle.expected_utility, abs=1e-8)


def test_more_than_can_be_used_is_not_used():
    found = at_rate(IDENTITY, None, 5.0)
    assert found.expected_utility == pytest.approx(0.8)
    assert found.end_to_end_information == pytest.approx(math.log(3))
    assert found.beta == math.inf and found.jump is None


@pytest.mark.parametrize("bits", [-1, math.nan, math.inf, "1", True, None])
def test_what_is_no_rate_is_refused(bits):
    with pytest.raises(ValueError, match="bits must be a finite number of at least 0"):
        at_rate(IDENTITY, None, bits)
