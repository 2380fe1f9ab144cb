import math
import warnings

import numpy as np
import pytest
import torch
from problems import (
    IDENTITY,
    MUGS,
    PREDATOR_PREY,
    ROUGH,
    assert_consistent,
    binary_entropy,
    random_problem,
)

from bra.blahut_arimoto import rate_distortion, serial

# Closed forms


def test_serial_binary_symmetric_chain():
    result = serial(IDENTITY, None, 2, 3.0, 3.0)
    assert result.converged
    assert result.expected_utility == pytest.approx(0.86856232, abs=5e-9)
    assert result.perception_information == pytest.approx(0.43764932, abs=5e-9)
    assert result.action_information == pytest.approx(0.43764932, abs=5e-9)
    assert result.objective == pytest.approx(0.57679611, abs=5e-9)
    assert_consistent(result, [0.5, 0.5], [3.0, 3.0])


@pytest.mark.parametrize("beta_1", [1.5, 3.0, 8.0])
@pytest.mark.parametrize("beta_2", [3.0, 5.0])
def test_serial_binary_chain_solves_its_fixed_point_equations(beta_1, beta_2):
    right_1, right_2 = 1.0, 1.0
    for _ in range(2000):
        right_1 = 1 / (1 + math.exp(-beta_1 * (2 * right_2 - 1)))
        right_2 = 1 / (1 + math.exp(-beta_2 * (2 * right_1 - 1)))
    result = serial(IDENTITY, None, 2, beta_1, beta_2)
    utility = right_1 * right_2 + (1 - right_1) * (1 - right_2)
    assert result.expected_utility == pytest.approx(utility, abs=1e-7)
    assert result.perception_information == pytest.approx(
        math.log(2) - binary_entropy(right_1), abs=1e-7
    )


@pytest.mark.parametrize(("beta_1", "beta_2"), [(1.0, 3.9), (2.0, 1.9), (0.1, 10.0)])
def test_serial_binary_chain_is_silent_below_its_critical_product(beta_1, beta_2):
    result = serial(IDENTITY, None, 2, beta_1, beta_2)
    assert result.objective == pytest.approx(0.5, abs=1e-12)
    assert result.end_to_end_information == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    ("percepts", "beta_1", "beta_2", "beta"),
    [(6, 1e6, 4.0, 4.0), (9, 1e6, 0.5, 0.5), (5, 4.0, 1e6, 4.0), (8, 20.0, 1e6, 20.0)],
)
def test_one_free_channel_leaves_the_problem_of_the_other(percepts, beta_1, beta_2, beta):
    utilities, prior = random_problem(6, 5, seed=1)
    chain = serial(utilities, prior, percepts, beta_1, beta_2)
    single = rate_distortion(utilities, prior, beta)
    # The free channel still costs at most ln 6 / 1e6.
    assert chain.objective == pytest.approx(single.objective, abs=2e-6)
    assert chain.end_to_end_information == pytest.approx(single.end_to_end_information, abs=1e-4)


@pytest.mark.parametrize("utilities", [PREDATOR_PREY, MUGS, ROUGH])
def test_low_prices_leave_the_best_constant_action(utilities):
    best = torch.tensor(utilities).double().mean(0).max().item()
    result = serial(utilities, None, 4, 1e-6, 1e-6)
    assert result.expected_utility == pytest.approx(best, abs=1e-8)
    assert result.converged


def test_one_percept_is_a_constant_policy():
    result = serial(PREDATOR_PREY, None, 1, 8.0, 10.0)
    best = torch.tensor(PREDATOR_PREY).double().mean(0).max().item()
    assert result.objective == pytest.approx(best, abs=1e-12)
    assert result.end_to_end_information == pytest.approx(0.0, abs=1e-12)


# Reference values


@pytest.mark.parametrize(
    ("betas", "objective", "utility", "perception_bits", "action_bits", "bound"),
    [
        ((8, 10), 3.27049, 3.59940, 2.1068, 2.1116, 3.27475),
        ((8, 1), 2.54754, 3.06615, 0.9183, 0.6334, 2.60054),
        ((1, 10), 2.56010, 3.07123, 0.6408, 0.9656, 2.61149),
        ((1, 1), 2.04489, 2.87941, 0.6204, 0.5836, 2.33075),
        ((0.5, 0.5), 2.00000, 2.00000, 0.0, 0.0, 2.10164),
    ],
)
def test_predator_prey(betas, objective, utility, perception_bits, action_bits, bound):
    result = serial(PREDATOR_PREY, None, 13, *betas)
    assert result.converged
    assert result.objective == pytest.approx(objective, abs=5.1e-6)
    assert result.expected_utility == pytest.approx(utility, abs=5.1e-6)
    assert result.perception_information / math.log(2) == pytest.approx(perception_bits, abs=5.1e-5)
    assert result.action_information / math.log(2) == pytest.approx(action_bits, abs=5.1e-5)
    assert result.upper_bound == pytest.approx(bound, abs=5.1e-6)
    assert_consistent(result, [1 / 9] * 9, betas)


@pytest.mark.parametrize(
    ("betas", "objective", "utility"),
    [((2, 3), 3.8500, 4.977), ((2, 0.5), 2.7857, 3.582), ((0.5, 0.5), 2.7500, 2.750)],
)
def test_mug_lifting(betas, objective, utility):
    result = serial(MUGS, None, 4, *betas)
    assert result.objective == pytest.approx(objective, abs=5.1e-5)
    assert result.expected_utility == pytest.approx(utility, abs=5.1e-4)


# Against the same equations, written plainly


def plain_serial(utilities, prior, percepts, beta_1, beta_2, restarts, seed):
    """J at the end of 2000 sweeps from each of some random starts."""
    rng = np.random.default_rng(seed)
    action = rng.dirichlet(0.3 * np.ones(utilities.shape[1]), size=(restarts, percepts))
    percept = np.full((restarts, 1, percepts), 1 / percepts)
    marginal = percept @ action
    for _ in range(2000):
        cost = (action * np.log(np.maximum(action, 1e-300) / np.maximum(marginal, 1e-300))).sum(2)
        free_utility = utilities @ action.swapaxes(1, 2) - cost[:, None] / beta_2
        perception = percept * np.exp(beta_1 * free_utility)
        partition = perception.sum(2, keepdims=True)
        perception /= partition
        objective = np.log(partition[..., 0]) @ prior / beta_1
        percept = np.maximum(prior @ perception, 1e-250)[:, None]
        belief = (prior[:, None] * perception).swapaxes(1, 2) @ utilities / percept.swapaxes(1, 2)
        action = marginal * np.exp(beta_2 * belief)
        action /= action.sum(2, keepdims=True)
        marginal = percept @ action
    return objective


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("betas", [(2.0, 5.0), (10.0, 6.0)])
def test_serial_is_no_worse_than_plain_iteration(seed, betas):
    utilities, prior = random_problem(5, 4, seed)
    plain = plain_serial(utilities, prior, 4, *betas, restarts=8, seed=seed).max()
    result = serial(utilities, prior, 4, *betas)
    assert result.converged
    assert result.objective >= plain - 1e-9
    assert_consistent(result, prior, betas)


# The climb


def test_sweeps_and_extrapolations_never_lower_the_objective(monkeypatch):
    utilities, prior = random_problem(8, 8, seed=3)
    before = torch.full((12,), -math.inf, dtype=torch.float64)
    for cap in (1, 4, 7, 10, 13, 16, 19, 31, 61, 121, 301, 304, 601):
        monkeypatch.setattr("bra.blahut_arimoto.climb.SWEEP_CAP", cap)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optima = serial(utilities, prior, 6, 12.0, 5.0, restarts=12, budget=12).optima
        assert (optima >= before - 1e-13).all()
        before = optima


@pytest.mark.parametrize("betas", [(8.0, 10.0), (1.0, 10.0), (1.0, 1.0)])
def test_returned_point_satisfies_the_self_consistent_equations(betas):
    beta_1, beta_2 = betas
    utilities = torch.tensor(PREDATOR_PREY, dtype=torch.float64)
    found = serial(utilities, None, 13, *betas)
    used = found.percept_marginal > 1e-8
    perception, action = found.percept_given_state[:, used], found.action_given_percept[used]
    percept, marginal = found.percept_marginal[used], found.action_marginal
    cost = torch.special.xlogy(action, action / marginal.clamp(min=1e-300)).sum(1)
    free_utility = utilities @ action.mT - cost / beta_2
    expected_perception = (percept.log() + beta_1 * free_utility).softmax(1)
    belief = (perception / 9 / percept).mT @ utilities
    expected_action = (marginal.log() + beta_2 * belief).softmax(1)
    torch.testing.assert_close(perception, expected_perception, atol=1e-5, rtol=0)
    torch.testing.assert_close(action, expected_action, atol=1e-5, rtol=0)


def test_cap_is_reported(monkeypatch):
    for user in ("climb", "solution"):
        monkeypatch.setattr(f"bra.blahut_arimoto.{user}.SWEEP_CAP", 4)
    with pytest.warns(
        UserWarning, match=r"serial: \d+ of 8 solves did not converge within 4 sweeps"
    ) as caught:
        result = serial(PREDATOR_PREY, None, 13, [1.0, 1e-5], [1.0, 1e-5], restarts=4, budget=4)
    assert caught[0].filename == __file__
    assert result.converged.dtype == torch.bool
    assert not result.converged[0]


def test_same_seed_same_result():
    first, second = (
        serial(MUGS, None, 4, 2.0, 3.0, restarts=5, seed=7, budget=5) for _ in range(2)
    )
    assert torch.equal(first.optima, second.optima)
    assert torch.equal(first.percept_given_state, second.percept_given_state)
    assert first.optima.shape == (5,)


def test_more_restarts_include_fewer():
    few, more = (serial(MUGS, None, 4, 2.0, 3.0, restarts=n, budget=n).optima for n in (5, 12))
    torch.testing.assert_close(more[:5], few, atol=1e-12, rtol=0)
