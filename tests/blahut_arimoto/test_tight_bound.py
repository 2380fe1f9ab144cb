"""The bound from contraction and capacity."""

import math

import numpy as np
import pytest
import torch
from problems import IDENTITY, MUGS, PREDATOR_PREY, binary_entropy, random_problem

from bra.blahut_arimoto import rate_distortion, serial
from bra.blahut_arimoto.tight_bound import bounds, contractions, contrast

TABLE = torch.tensor(PREDATOR_PREY, dtype=torch.double)


def random_prices(count, seed):
    return torch.as_tensor(10 ** np.random.default_rng(seed).uniform(-1, 1.5, (2, count)))


@pytest.mark.parametrize(
    ("betas", "percepts", "bound"),
    [
        ((8, 10), 13, 3.27475),
        ((8, 1), 13, 2.59644),
        ((1, 10), 13, 2.60814),
        ((1, 1), 13, 2.29478),
        ((0.5, 0.5), 13, 2.0),
        ((8, 10), 3, 3.25614),
        ((8, 10), 2, 3.14648),
    ],
)
def test_predator_prey(betas, percepts, bound):
    found = serial(PREDATOR_PREY, None, percepts, *betas)
    assert found.tight_bound == pytest.approx(bound, abs=5.1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_no_solution_exceeds_it_and_it_never_exceeds_the_other(seed):
    rng = np.random.default_rng(seed)
    states, actions, percepts = (int(n) for n in rng.integers([2, 2, 1], [8, 8, 6]))
    utilities, prior = random_problem(states, actions, seed)
    found = serial(5 * utilities, prior, percepts, *random_prices(10, seed), restarts=8)
    assert (found.objective <= found.tight_bound + 1e-11).all()
    assert (found.tight_bound <= found.upper_bound).all()


def test_contrast():
    table = torch.as_tensor(random_problem(4, 5, 0)[0])
    pairs = table[:, None, :, None] - table[:, None, None, :]
    expected = (pairs - pairs.transpose(0, 1)).abs().amax()
    assert contrast(table) == pytest.approx(expected.item(), rel=1e-14)
    assert contrast(TABLE) == 8.0


@pytest.mark.parametrize("seed", range(6))
def test_optima_contract_as_the_proof_says(seed):
    utilities, prior = random_problem(5, 4, seed)
    beta_1, beta_2 = random_prices(8, seed)
    found = serial(8 * utilities, prior, 5, beta_1, beta_2, restarts=8)
    t, s = contractions(contrast(8 * torch.as_tensor(utilities)), beta_1, beta_2)
    for index in range(8):
        used = found.percept_marginal[index] > 1e-6
        joint = torch.as_tensor(prior)[:, None] * found.percept_given_state[index]
        posteriors = (joint / joint.sum(0)).T[used]
        actions = found.action_given_percept[index][used]
        assert torch.cdist(posteriors, posteriors, 1).max() / 2 <= t[index] + 1e-9
        assert torch.cdist(actions, actions, 1).max() / 2 <= s[index] + 1e-9
    end_to_end = found.end_to_end_information
    assert (end_to_end <= s**2 * found.perception_information + 1e-12).all()
    assert (end_to_end <= t**2 * found.action_information + 1e-12).all()


def test_two_states_are_worth_knowing_from_the_critical_prices_on():
    """D = 2, so that β₁β₂ = 4 is critical, and a symmetric chain is as far apart as can be."""
    below, above = (serial(IDENTITY, None, 2, 2 * f, 2 * f) for f in (0.999, 1.02))
    assert below.objective == below.tight_bound == pytest.approx(0.5, abs=1e-12)
    assert below.upper_bound > 0.501
    assert above.perception_information > 1e-3
    t, s = contractions(torch.tensor(2.0), *torch.tensor([[3.0], [5.0]], dtype=torch.double))
    found = serial(IDENTITY, None, 2, 3.0, 5.0)
    assert found.percept_given_state.diff(dim=0).abs().max().item() == pytest.approx(t.item())
    assert found.action_given_percept.diff(dim=0).abs().max().item() == pytest.approx(s.item())


@pytest.mark.parametrize("betas", [(0.5, 0.5), (0.25, 0.5)])
def test_mugs_that_are_not_worth_telling_apart(betas):
    found = serial(MUGS, None, 4, *betas)
    assert found.objective == pytest.approx(found.tight_bound, abs=1e-12) == 2.75


def test_one_percept_knows_nothing():
    utilities, prior = random_problem(5, 4, 1)
    found = serial(utilities, prior, 1, 50.0, 50.0)
    best = (prior @ utilities).max()
    assert found.tight_bound == pytest.approx(best, abs=1e-12)
    assert found.objective == pytest.approx(best, abs=1e-12)


def test_few_percepts_cost_what_the_distortion_rate_function_says():
    """Of a uniform source of 4 and log 2 nats: log 4 − h(d) − d log 3 = log 2, E[U] = 1 − d."""
    low, high = 0.0, 0.75
    for _ in range(100):
        d = (low + high) / 2
        rate = math.log(4) - binary_entropy(d) - d * math.log(3)
        low, high = (d, high) if rate > math.log(2) else (low, d)
    betas = [torch.tensor([1e5], dtype=torch.double)] * 2
    prior = torch.full((4,), 0.25, dtype=torch.double)
    bound = bounds(torch.eye(4, dtype=torch.double), prior, *betas, 2).tight
    assert bound.item() == pytest.approx(1 - d, abs=2e-4)
    assert bound.item() >= 1 - d - 2e-5  # what the information costs


def test_enough_percepts_make_no_difference():
    utilities, prior = random_problem(6, 4, 2)
    betas = [torch.tensor([20.0, 1e4], dtype=torch.double)] * 2
    table, p = torch.as_tensor(utilities), torch.as_tensor(prior)
    four, more = (bounds(table, p, *betas, percepts).tight for percepts in (4, 9))
    assert torch.equal(four, more)
    assert four[1] == pytest.approx(rate_distortion(utilities, prior, 5e3).upper_bound, abs=1e-10)


def test_states_that_never_occur_do_not_count():
    betas = torch.tensor([[0.9], [0.9]], dtype=torch.double)
    far = torch.tensor([*IDENTITY, [100.0, 0.0]], dtype=torch.double)
    bound = bounds(far, torch.tensor([0.5, 0.5, 0.0], dtype=torch.double), *betas, 3).tight
    assert bound.item() == 0.5


@pytest.mark.parametrize("betas", [(1e250, 1e-170), (1e200, 1e-199), (1e-6, 1e6)])
def test_prices_whose_squares_leave_the_range_of_numbers(betas):
    found = serial(IDENTITY, None, 2, *betas, restarts=2)
    assert found.objective - 1e-12 <= found.tight_bound <= found.upper_bound
