"""Perception, and actions that look at the state again."""

import math

import numpy as np
import pytest
import torch
from problems import IDENTITY, PREDATOR_PREY, random_problem

from bra.blahut_arimoto import general, rate_distortion, serial
from bra.information import mutual_information

INF = math.inf
MEDICAL = [
    [3, 0.9, 0, 0, 0, 0, 0, 0, 1.5, 0],
    [0.9, 3, 0, 0, 0, 0, 0, 0, 1.5, 0],
    [0, 0, 3, 1.5, 0, 0, 2.5, 0, 0, 1.5],
    [0, 0, 1.5, 3, 0, 0, 2.5, 0, 0, 1.5],
    [0, 0, 0, 0, 3, 1.5, 0, 2.5, 0, 1.5],
    [0, 0, 0, 0, 1.5, 3, 0, 2.5, 0, 1.5],
]
UNIFORM, HEART_HEAVY = [1 / 6] * 6, [0.3, 0.3, 0.1, 0.1, 0.1, 0.1]


def plain_general(utilities, prior, percepts, betas, starts, seed):
    """J at the end of plain sweeps of the self-consistent equations from random starts."""
    rng = np.random.default_rng(seed)
    beta_1, beta_2, beta_3 = betas
    rows = rng.dirichlet(0.5 * np.ones(utilities.shape[1]), (starts, percepts)) + 1e-12
    percept = np.full((starts, percepts), 1 / percepts)
    for _ in range(3000):
        marginal = np.einsum("nx,nxa->na", percept, rows)
        tilt = (np.log(rows) - np.log(marginal)[:, None]) / beta_2
        weights = rows[:, :, None] * np.exp(beta_3 * (utilities - tilt[:, :, None]))
        partition = weights.sum(3)
        action = weights / partition[..., None]
        logits = np.log(percept)[:, :, None] + beta_1 / beta_3 * np.log(partition)
        highest = logits.max(1, keepdims=True)
        perception = np.exp(logits - highest)
        total = perception.sum(1, keepdims=True)
        perception /= total
        objective = (highest + np.log(total))[:, 0] @ prior / beta_1
        joint = perception * prior
        percept = np.maximum(joint.sum(2), 1e-200)
        rows = np.maximum((joint[..., None] * action).sum(2) / percept[..., None], 1e-200)
    return objective


def assert_consistent(found, utilities, prior, betas):
    """Channels are distributions, and every number follows from them."""
    prior = torch.tensor(prior, dtype=torch.float64)
    perception, action = found.percept_given_state, found.action_given_percept_and_state
    for rows in (perception, action, found.action_given_percept):
        torch.testing.assert_close(rows.sum(-1), torch.ones_like(rows[..., 0]))
    joint = (prior[:, None] * perception).mT
    behaviour = torch.einsum("wx,xwa->wa", perception, action)
    torch.testing.assert_close(behaviour, found.action_given_state)
    used = found.percept_marginal > 1e-12
    mean = torch.einsum("xw,xwa->xa", joint, action)[used] / joint.sum(1)[used, None]
    torch.testing.assert_close(mean, found.action_given_percept[used])
    perceived = mutual_information(prior, perception).item()
    acted = mutual_information(joint.sum(1)[used], mean).item()
    both = torch.einsum("wx,xwa->wxa", perception, action).flatten(1)
    direct = mutual_information(prior, both).item() - perceived
    assert found.perception_information == pytest.approx(perceived, abs=1e-8)
    assert found.action_information == pytest.approx(acted, abs=1e-8)
    assert found.direct_information == pytest.approx(direct, abs=1e-8)
    table = torch.tensor(utilities, dtype=torch.float64)
    reachable = torch.where(behaviour > 0, table, 0.0)
    utility = (prior[:, None] * behaviour * reachable).sum().item()
    assert found.expected_utility == pytest.approx(utility, abs=1e-8)
    costs = [i / b if b else 0.0 for i, b in zip((perceived, acted, direct), betas, strict=True)]
    assert found.objective == pytest.approx(utility - sum(costs), abs=1e-8)
    assert found.objective <= found.upper_bound + 1e-12


# Reference values


@pytest.mark.parametrize(
    ("prior", "betas", "objective", "utility", "informations", "bound"),
    [
        (UNIFORM, (1, INF, 0.9), 1.521156, 2.197897, (0.582055, 1.098471, 0.085218), 1.536076),
        (UNIFORM, (2.5, INF, 1), 2.041820, 2.730048, (1.069365, 1.098612, 0.260482), 2.165027),
        (UNIFORM, (10, 5, 2), 2.342520, 2.942223, (1.098612, 1.098567, 0.540257), 2.347273),
        (UNIFORM, (8, 10, 3), 2.524422, 2.987730, (1.098612, 1.098612, 0.648360), 2.524585),
        (HEART_HEAVY, (1, INF, 0.9), 1.643503, 2.275281, (0.505160, 1.098485, 0.113956), 1.659385),
        (HEART_HEAVY, (2.5, INF, 1), 2.125342, 2.787183, (1.035207, 1.090255, 0.247758), 2.263857),
        (HEART_HEAVY, (10, 5, 2), 2.406735, 2.965988, (1.088900, 1.088641, 0.465268), 2.416928),
        (HEART_HEAVY, (8, 10, 3), 2.571664, 2.993117, (1.088899, 1.088900, 0.529351), 2.573213),
    ],
)
def test_medical(prior, betas, objective, utility, informations, bound):
    found = general(MEDICAL, prior, 3, *betas, budget=32)
    assert found.converged
    assert found.objective == pytest.approx(objective, abs=1e-6)
    assert found.expected_utility == pytest.approx(utility, abs=2e-6)
    assert found.perception_information == pytest.approx(informations[0], abs=2e-6)
    if betas[1] < INF:  # else it is free, and not unique
        assert found.action_information == pytest.approx(informations[1], abs=2e-6)
    assert found.direct_information == pytest.approx(informations[2], abs=2e-6)
    assert bound - 1e-5 < found.upper_bound < bound + 1e-6
    assert_consistent(found, MEDICAL, prior, betas)


@pytest.mark.parametrize(("percepts", "gap"), [(3, 0.123203), (4, 0.111963), (6, 0.0)])
def test_the_bound_closes_where_percepts_are_many(percepts, gap):
    found = general(MEDICAL, UNIFORM, percepts, 2.5, INF, 1, budget=32)
    assert found.upper_bound - found.objective == pytest.approx(gap, abs=2e-6)
    if percepts == 6:
        assert found.objective == pytest.approx(2.291062, abs=1e-6)


# Limits


@pytest.mark.parametrize(
    ("betas", "beta"),
    [((1, 1, 0.7), 0.7), ((2, INF, 2), 2), ((3, 6, 2), 2), ((0.5, 9, 2), 2), ((INF, 1, 5), 5)],
)
def test_percepts_that_are_too_dear_leave_one_channel(betas, beta):
    found = general(MEDICAL, HEART_HEAVY, 3, *betas)
    single = rate_distortion(MEDICAL, HEART_HEAVY, beta)
    assert found.objective == pytest.approx(single.objective, abs=1e-10)
    assert found.upper_bound == pytest.approx(single.upper_bound, abs=1e-10)
    assert found.perception_information == found.action_information == 0
    assert found.direct_information == pytest.approx(single.end_to_end_information, abs=1e-8)
    assert_consistent(found, MEDICAL, HEART_HEAVY, betas)


def test_one_percept_leaves_one_channel():
    found = general(MEDICAL, None, 1, 8.0, 10.0, 3.0)
    single = rate_distortion(MEDICAL, None, 3.0)
    assert found.objective == pytest.approx(single.objective, abs=1e-10)
    assert found.upper_bound == pytest.approx(single.objective, abs=1e-10)


@pytest.mark.parametrize("beta_direct", [None, 0])
def test_actions_that_do_not_look_again_are_serial(beta_direct):
    found = general(PREDATOR_PREY, None, 13, 8.0, 10.0, beta_direct)
    chain = serial(PREDATOR_PREY, None, 13, 8.0, 10.0)
    assert found.objective == chain.objective
    assert found.direct_information == 0
    assert torch.equal(found.optima, chain.optima)
    assert_consistent(found, PREDATOR_PREY, [1 / 9] * 9, (8.0, 10.0, 0))


@pytest.mark.parametrize(
    "betas",
    [(8, 10), (1, 1), *(pytest.param(b, marks=pytest.mark.slow) for b in ((8, 1), (1, 10)))],
)
def test_dear_looks_approach_serial_at_the_rate_of_the_envelope(betas):
    chain = serial(PREDATOR_PREY, None, 13, *betas)
    found = general(PREDATOR_PREY, None, 13, *betas, 1e-6)
    assert found.converged
    assert found.objective == pytest.approx(chain.objective, abs=1e-7)
    # dJ/dc₃ = −t and t ~ β₃², hence J − J_serial = t/β₃ to first order.
    rise = found.direct_information / 1e-6
    assert found.objective - chain.objective == pytest.approx(rise, rel=1e-2, abs=1e-11)


def test_free_perception_sorts_states():
    found = general(MEDICAL, None, 3, INF, INF, 1.0, budget=32)
    assert ((found.percept_given_state < 1e-9) | (found.percept_given_state > 1 - 1e-9)).all()
    halves = 3 / (1 + math.exp(-1.5))  # a lower bound: pairs, told apart at the price of 1
    assert found.objective > halves - math.log(2) / 2
    assert found.upper_bound >= found.objective


# Against others


@pytest.mark.parametrize("seed", range(4))
def test_no_perception_of_two_states_is_better(seed):
    rng = np.random.default_rng(seed)
    utilities, prior = 3 * rng.standard_normal((2, 2)), rng.dirichlet([2, 2])
    beta_1, beta_2, beta_3 = 4.0, 6.0, 1.0
    grid = np.linspace(0, 1, 61)
    first, second = (axis.ravel() for axis in np.meshgrid(grid, grid))
    perception = np.stack([[first, 1 - first], [second, 1 - second]])  # (W, X, n)
    joint = prior[:, None, None] * perception
    percept = joint.sum(0)
    rows = np.full((2, *percept.shape), 0.5)  # (A, X, n)
    for _ in range(1000):  # concave in p(a|x) and p(a)
        marginal = (percept * rows).sum(1, keepdims=True)
        logits = np.log(rows) - beta_3 / beta_2 * np.log(rows / marginal)
        weights = np.exp(logits + beta_3 * utilities[:, :, None, None])  # (W, A, X, n)
        partition = weights.sum(1)
        taken = (joint[:, None] * weights / partition[:, None]).sum(0)
        rows = np.maximum(taken / np.maximum(percept, 1e-300), 1e-200)
    ratio = np.where(perception > 0, perception / np.maximum(percept, 1e-300), 1.0)
    value = (joint * (np.log(partition) / beta_3 - np.log(ratio) / beta_1)).sum((0, 1))
    found = general(utilities, prior, 2, beta_1, beta_2, beta_3)
    assert value.max() <= found.objective + 1e-9
    assert value.max() >= found.objective - 3e-3


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))])
@pytest.mark.parametrize("betas", [(8.0, 10.0, 3.0), (5.0, 20.0, 0.5), (2.5, 1e9, 1.0)])
def test_no_plain_iteration_is_better(seed, betas):
    utilities, prior = random_problem(6, 5, seed)
    utilities = 4 * utilities
    plain = plain_general(utilities, prior, 3, betas, starts=20, seed=seed).max()
    found = general(utilities, prior, 3, *betas)
    assert found.converged
    assert found.objective >= plain - 1e-9
    assert_consistent(found, utilities, prior, betas)


def test_the_end_satisfies_the_self_consistent_equations():
    beta_1, beta_2, beta_3 = 10.0, 5.0, 2.0
    found = general(MEDICAL, HEART_HEAVY, 3, beta_1, beta_2, beta_3, budget=32)
    utilities = torch.tensor(MEDICAL, dtype=torch.float64)
    rows, marginal = found.action_given_percept, found.action_marginal
    cost = torch.where(rows > 1e-12, rows / marginal.clamp(min=1e-300), 1.0).log() / beta_2
    logits = rows.clamp(min=1e-300).log()[:, None] + beta_3 * (utilities - cost[:, None])
    torch.testing.assert_close(
        logits.softmax(2), found.action_given_percept_and_state, atol=1e-5, rtol=0
    )
    attended = found.percept_marginal.log() + beta_1 / beta_3 * logits.logsumexp(2).mT
    torch.testing.assert_close(attended.softmax(1), found.percept_given_state, atol=1e-5, rtol=0)


# Batches, scales, forbidden actions


def test_batches_of_prices_are_single_prices():
    beta_1, beta_2, beta_3 = torch.tensor([[10.0], [2.5]]), [5.0, INF], [2.0, 0.0]
    many = general(MEDICAL, None, 3, beta_1, beta_2, beta_3, restarts=8, budget=16)
    assert many.objective.shape == (2, 2)
    assert many.action_given_percept_and_state.shape == (2, 2, 3, 6, 10)
    for i, j in ((0, 0), (1, 0)):
        one = general(MEDICAL, None, 3, beta_1[i], beta_2[j], beta_3[j], restarts=8, budget=16)
        assert many.objective[i, j].item() == pytest.approx(one.objective.item(), abs=1e-10)
        assert many.upper_bound[i, j].item() == pytest.approx(one.upper_bound.item(), abs=1e-10)
    assert (many.direct_information[:, 1] == 0).all()


@pytest.mark.parametrize(("factor", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e3)])
def test_scales(factor, offset):
    utilities = factor * torch.tensor(MEDICAL, dtype=torch.float64) + offset
    found = general(utilities, None, 3, 10 / factor, 5 / factor, 2 / factor, budget=32)
    assert (found.objective - offset) / factor == pytest.approx(2.342520, abs=1e-6)
    assert found.converged


def test_forbidden_actions_are_never_taken():
    forbidding = torch.full((3, 3), -INF).fill_diagonal_(0.0)
    found = general(forbidding, None, 2, 5.0, 5.0, 1.0)
    assert (found.action_given_state[forbidding.isinf()] == 0).all()
    sorted_out = math.log(3) - 2 / 3 * math.log(2)
    assert found.objective >= -0.4 * sorted_out - 2 / 3 * math.log(2) - 1e-9
    assert found.objective <= found.upper_bound
    alone = general(forbidding, None, 1, 5.0, 5.0, 1.0)
    assert alone.objective == pytest.approx(-math.log(3), abs=1e-9)


def test_penalties_are_avoided():
    rough = [[0.0, -1.0], [-1000.0, -1001.0]]
    found = general(rough, None, 2, 3.0, 3.0, 1.0)
    assert found.objective == pytest.approx(-500.0, abs=1e-9)
    assert general(IDENTITY, None, 2, 1e6, 1e6, 1e5).objective == pytest.approx(1.0, abs=1e-5)


def test_cap_is_reported(monkeypatch):
    for user in ("climb", "solution"):
        monkeypatch.setattr(f"bra.blahut_arimoto.{user}.SWEEP_CAP", 4)
    with pytest.warns(UserWarning, match="general: .* did not converge within 4 sweeps") as caught:
        found = general(MEDICAL, None, 3, 8.0, 10.0, 3.0, restarts=4, budget=4)
    assert caught[0].filename == __file__
    assert not found.converged
