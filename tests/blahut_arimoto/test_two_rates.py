"""What the chain Ω → X → A earns within budgets of information."""

import math

import pytest
import torch

from bra.blahut_arimoto import at_rate, serial
from bra.information import mutual_information
from bra.tasks import PredatorPrey

LN2 = math.log(2)
TASK = PredatorPrey()
PREY = TASK.utilities, TASK.prior


def binary_problem(seed):
    generator = torch.Generator().manual_seed(seed)
    utilities = torch.randn(2, 2, generator=generator, dtype=torch.float64)
    prior = 0.2 + torch.rand(2, generator=generator, dtype=torch.float64)
    return utilities, prior / prior.sum()


def best_on_a_grid(utilities, prior, bits, points=25):
    """The best pair of binary channels within both budgets, by trying all on a grid."""
    grid = torch.linspace(0, 1, points, dtype=torch.float64)
    rows = torch.cartesian_prod(grid, grid)
    channels = torch.stack((rows, 1 - rows), -1)
    limits = [budget * LN2 + 1e-12 for budget in bits]
    best = -math.inf
    for perception in channels[mutual_information(prior, channels) <= limits[0]]:
        percepts = (prior @ perception).expand(len(channels), -1)
        within = mutual_information(percepts, channels) <= limits[1]
        earned = ((perception @ channels[within]) * utilities).sum(-1) @ prior
        best = max(best, earned.max().item())
    return best


@pytest.mark.parametrize("bits", [(0.3, 0.3), (0.1, 0.6), (2.0, 0.2)])
@pytest.mark.parametrize("seed", [0, pytest.param(4, marks=pytest.mark.slow)])
def test_nothing_within_the_budgets_earns_more(seed, bits):
    utilities, prior = binary_problem(seed)
    found = serial(utilities, prior, 2, perception_bits=bits[0], action_bits=bits[1])
    best = best_on_a_grid(utilities, prior, bits)
    assert best <= found.expected_utility + 1e-6 <= found.upper_bound + 2e-6
    assert found.perception_information <= bits[0] * LN2 + 1e-5
    assert found.action_information <= bits[1] * LN2 + 1e-5
    if not found.jump:  # what the steps of the grid leave out
        assert found.expected_utility == pytest.approx(best, abs=0.016)


@pytest.mark.parametrize("bits", [pytest.param(0.1, marks=pytest.mark.slow), 0.5])
def test_one_channel_alone_is_limited(bits):
    utilities, prior = binary_problem(0)
    single = at_rate(utilities, prior, bits)
    for budgets in ((bits, 5.0), (5.0, bits)):
        found = serial(utilities, prior, 2, perception_bits=budgets[0], action_bits=budgets[1])
        assert found.expected_utility == pytest.approx(single.expected_utility, abs=1e-9)
        betas = found.beta_perception, found.beta_action
        assert min(betas) == pytest.approx(single.beta, rel=1e-4) and max(betas) == math.inf


def test_prices_and_rates_are_two_ways_to_say_the_same():
    at_prices = serial(*PREY, 6, 8.0, 10.0)
    rates = at_prices.perception_information / LN2, at_prices.action_information / LN2
    found = serial(*PREY, 6, perception_bits=rates[0], action_bits=rates[1])
    assert not found.jump and found.ends[0].converged
    assert (found.beta_perception, found.beta_action) == pytest.approx((8, 10), rel=1e-3)
    assert found.expected_utility == pytest.approx(at_prices.expected_utility, abs=1e-7)
    half = serial(*PREY, 6, perception_bits=rates[0], beta_action=10.0)
    assert half.beta_perception == pytest.approx(8, rel=1e-3) and half.beta_action == 10
    worth = at_prices.expected_utility - at_prices.action_information / 10
    assert half.objective == pytest.approx(worth, abs=1e-7)
    assert half.objective < half.upper_bound


def test_rates_that_no_price_has_are_shared_between_ends():
    """Information becomes worth its price by a jump to half a bit."""
    found = serial(*PREY, 6, perception_bits=0.3, action_bits=0.3)
    assert found.jump and sum(found.shares) == pytest.approx(1)
    nothing = min(found.ends, key=lambda end: end.perception_information)
    assert nothing.perception_information == 0
    assert found.perception_information == pytest.approx(0.3 * LN2, abs=1e-5)
    prices = found.beta_perception, found.beta_action
    values = [end.expected_utility for end in found.ends]
    costs = [
        end.perception_information / prices[0] + end.action_information / prices[1]
        for end in found.ends
    ]
    assert values[0] - costs[0] == pytest.approx(values[1] - costs[1], abs=1e-5)


@pytest.mark.parametrize("limits", [(0.0, 0.0), (0.0, 0.5), (1.0, 0)])
def test_without_information_the_best_single_action_is_taken(limits):
    found = serial(*PREY, 6, perception_bits=limits[0], action_bits=limits[1])
    assert found.expected_utility == pytest.approx(2.0) and found.upper_bound == pytest.approx(2)
    assert found.perception_information == found.action_information == 0


def test_more_than_can_be_used_is_not_used():
    found = serial(*PREY, 6, perception_bits=9.0, action_bits=9)
    assert found.expected_utility == pytest.approx(3.6)
    assert found.beta_perception == found.beta_action == math.inf and not found.jump


def test_a_bound_is_certified_where_time_is_given():
    utilities, prior = binary_problem(0)
    budgets = {"perception_bits": 0.3, "action_bits": 0.3}
    loose = serial(utilities, prior, 2, **budgets)
    tight = serial(utilities, prior, 2, **budgets, certify=5.0)
    assert tight.expected_utility <= tight.upper_bound < loose.upper_bound - 1e-3


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"perception_bits": 1.0}, "give beta_action, a price, or action_bits, a budget"),
        ({}, "beta_perception must be a number"),
        (
            {"perception_bits": 1.0, "beta_perception": 2.0, "beta_action": 2.0},
            "perception channel has a price and a budget: beta_perception 2.0 and perception_bits",
        ),
        ({"perception_bits": -1.0, "beta_action": 2.0}, "perception_bits must be a finite number"),
        ({"perception_bits": 1.0, "beta_action": [2.0, 3.0]}, "beta_action must be positive and"),
    ],
)
def test_a_channel_has_a_price_or_a_budget(given, message):
    with pytest.raises(ValueError, match=message):
        serial(*PREY, 6, **given)
