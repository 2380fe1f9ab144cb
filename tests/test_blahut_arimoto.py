import dataclasses
import math
import warnings

import numpy as np
import pytest
import torch

from bra import blahut_arimoto
from bra.blahut_arimoto import RateDistortion, Serial, rate_distortion, serial
from bra.information import mutual_information

IDENTITY = [[1.0, 0.0], [0.0, 1.0]]
PREDATOR_PREY = [
    [3.5, 2.4, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
    [2.4, 3.5, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
    [2.4, 2.4, 3.5, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
    [1.5, 1.5, 1.5, 2.3, 1.84, 1.84, 2.3, 1.5, 0.5],
    [1.5, 1.5, 1.5, 1.84, 2.3, 1.84, 2.3, 1.5, 0.5],
    [1.5, 1.5, 1.5, 1.84, 1.84, 2.3, 2.3, 1.5, 0.5],
    *[[0.0] * 8 + [5.0]] * 3,
]
MUGS = [[5.0, 0, 0, 0], [0, 5.0, 0, 3.0], [0, 0, 5.0, 3.0], [0, 0, 0, 5.0]]
ONE_STATE = [[1.0, 3.0, 2.0]]
ONE_ACTION = [[1.0], [4.0]]
ROUGH = [[0.0, -1.0], [-1000.0, -1001.0]]


def binary_entropy(p):
    return -p * math.log(p) - (1 - p) * math.log(1 - p)


def random_problem(states, actions, seed):
    rng = np.random.default_rng(seed)
    return rng.random((states, actions)), rng.dirichlet(np.ones(states))


def assert_consistent(result, prior, betas):
    """Channels are distributions, and every number follows from them."""
    prior = torch.as_tensor(prior, dtype=torch.float64)
    for name in ("action_given_state", "percept_given_state", "action_given_percept"):
        if hasattr(result, name):
            rows = getattr(result, name)
            assert rows.dtype == torch.float64
            assert (rows >= 0).all()
            torch.testing.assert_close(rows.sum(-1), torch.ones_like(rows[..., 0]))
    behaviour = mutual_information(prior, result.action_given_state)
    assert result.end_to_end_information == pytest.approx(behaviour.item(), abs=1e-13)
    if isinstance(result, RateDistortion):
        price = result.end_to_end_information / betas[0]
        assert result.upper_bound == pytest.approx(result.objective + result.gap, rel=1e-15)
    else:
        torch.testing.assert_close(prior @ result.percept_given_state, result.percept_marginal)
        price = result.perception_information / betas[0] + result.action_information / betas[1]
        least = min(result.perception_information, result.action_information)
        assert result.end_to_end_information <= least + 1e-13
        assert result.objective == pytest.approx(result.optima.max().item(), rel=1e-8)
    torch.testing.assert_close(prior @ result.action_given_state, result.action_marginal)
    scale = max(1.0, abs(result.objective))
    assert result.objective == pytest.approx(result.expected_utility - price, abs=1e-12 * scale)
    assert result.objective <= result.upper_bound + 1e-12 * scale


# Closed forms


@pytest.mark.parametrize("beta", [1e-6, 0.1, 1.0, 5.0, 30.0, 1e6])
def test_binary_symmetric_source(beta):
    result = rate_distortion(IDENTITY, None, beta)
    right = 1 / (1 + math.exp(-beta))
    information = math.log(2) - binary_entropy(right) if right < 1 else math.log(2)
    assert result.converged
    assert result.expected_utility == pytest.approx(right, abs=1e-10)
    assert result.end_to_end_information == pytest.approx(information, abs=1e-10)
    assert_consistent(result, [0.5, 0.5], [beta])


@pytest.mark.parametrize("rare", [0.01, 0.2, 0.4])
@pytest.mark.parametrize("relative_price", [1e-3, 0.5, 1 - 1e-6, 1.0, 1 + 1e-6, 1.001, 2.0])
def test_bernoulli_source_is_silent_up_to_its_critical_price(rare, relative_price):
    critical = math.log((1 - rare) / rare)
    beta = relative_price * critical
    result = rate_distortion(IDENTITY, [1 - rare, rare], beta)
    error = min(rare, 1 / (1 + math.exp(beta)))
    information = binary_entropy(rare) - binary_entropy(error)
    assert result.converged
    assert result.gap <= 1e-12
    assert result.expected_utility == pytest.approx(1 - error, abs=1e-7)
    assert result.end_to_end_information == pytest.approx(information, abs=1e-7)
    assert result.objective == pytest.approx(1 - error - information / beta, abs=1e-12)


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("beta", [0.01, 1.0, 20.0])
def test_uniform_source_with_one_right_action_each(n, beta):
    result = rate_distortion(torch.eye(n), None, beta)
    assert result.objective == pytest.approx(
        math.log((math.exp(beta) + n - 1) / n) / beta, abs=1e-12
    )


def test_gaussian_source_on_a_grid():
    # On a grid much finer than the distortion the reverse water-filling formula holds as it stands.
    grid = torch.linspace(-6, 6, 121, dtype=torch.float64)
    prior = (-(grid**2) / 2).softmax(0)
    utilities = -((grid[:, None] - grid) ** 2)
    betas = [0.25, 1.0, 4.0]
    result = rate_distortion(utilities, prior, betas)
    distortion = torch.tensor([1.0, 0.5, 0.125], dtype=torch.float64)
    information = torch.tensor([0.0, math.log(2) / 2, math.log(8) / 2], dtype=torch.float64)
    torch.testing.assert_close(-result.expected_utility, distortion, atol=1e-6, rtol=0)
    torch.testing.assert_close(result.end_to_end_information, information, atol=1e-6, rtol=0)


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
    single = rate_distortion(utilities, None, 1e-6)
    chain = serial(utilities, None, 4, 1e-6, 1e-6)
    assert single.expected_utility == pytest.approx(best, abs=1e-8)
    assert chain.expected_utility == pytest.approx(best, abs=1e-8)
    assert chain.converged


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


def plain_one_channel(utilities, prior, beta):
    q = np.full(utilities.shape[1], 1 / utilities.shape[1])
    kernel = np.exp(beta * utilities)
    for _ in range(200_000):
        growth = prior @ (kernel / (kernel @ q)[:, None])
        if np.log(growth.max()) / beta < 1e-11:
            break
        q = q * growth
    return prior @ np.log(kernel @ q) / beta


def plain_serial(utilities, prior, percepts, beta_1, beta_2, rng):
    action = rng.dirichlet(0.3 * np.ones(utilities.shape[1]), size=percepts)
    percept = np.full(percepts, 1 / percepts)
    marginal = percept @ action
    for _ in range(2000):
        cost = (action * np.log(np.maximum(action, 1e-300) / np.maximum(marginal, 1e-300))).sum(1)
        perception = percept * np.exp(beta_1 * (utilities @ action.T - cost / beta_2))
        perception /= perception.sum(1, keepdims=True)
        percept = np.maximum(prior @ perception, 1e-250)
        belief = (prior[:, None] * perception).T @ utilities / percept[:, None]
        action = marginal * np.exp(beta_2 * belief)
        action /= action.sum(1, keepdims=True)
        marginal = percept @ action
    free = beta_1 * (prior @ (perception * (utilities @ action.T)).sum(1))
    free -= prior @ (perception * np.log(np.maximum(perception, 1e-300) / percept)).sum(1)
    ratio = np.maximum(action, 1e-300) / np.maximum(marginal, 1e-300)
    return free / beta_1 - percept @ (action * np.log(ratio)).sum(1) / beta_2


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("beta", [0.5, 4.0, 40.0])
def test_one_channel_agrees_with_plain_iteration(seed, beta):
    utilities, prior = random_problem(5, 6, seed)
    result = rate_distortion(utilities, prior, beta)
    assert result.objective == pytest.approx(plain_one_channel(utilities, prior, beta), abs=1e-9)
    assert_consistent(result, prior, [beta])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("betas", [(2.0, 5.0), (10.0, 6.0)])
def test_serial_is_no_worse_than_plain_iteration(seed, betas):
    utilities, prior = random_problem(5, 4, seed)
    rng = np.random.default_rng(seed)
    plain = max(plain_serial(utilities, prior, 4, *betas, rng) for _ in range(8))
    result = serial(utilities, prior, 4, *betas)
    assert result.converged
    assert result.objective >= plain - 1e-9
    assert_consistent(result, prior, betas)


# The climb


def test_sweeps_and_extrapolations_never_lower_the_objective(monkeypatch):
    utilities, prior = random_problem(8, 8, seed=3)
    before = torch.full((12,), -math.inf, dtype=torch.float64)
    for cap in (1, 4, 7, 10, 13, 16, 19, 31, 61, 121, 301, 304, 601):
        monkeypatch.setattr(blahut_arimoto, "SWEEP_CAP", cap)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optima = serial(utilities, prior, 6, 12.0, 5.0, restarts=12).optima
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
    cost = torch.special.xlogy(action, action / marginal).sum(1)
    free_utility = utilities @ action.mT - cost / beta_2
    expected_perception = (percept.log() + beta_1 * free_utility).softmax(1)
    belief = (perception / 9 / percept).mT @ utilities
    expected_action = (marginal.log() + beta_2 * belief).softmax(1)
    torch.testing.assert_close(perception, expected_perception, atol=1e-5, rtol=0)
    torch.testing.assert_close(action, expected_action, atol=1e-5, rtol=0)


def test_cap_is_reported(monkeypatch):
    monkeypatch.setattr(blahut_arimoto, "SWEEP_CAP", 4)
    with pytest.warns(
        UserWarning, match=r"serial: \d+ of 8 solves did not converge within 4 sweeps"
    ):
        result = serial(PREDATOR_PREY, None, 13, [1.0, 1e-5], [1.0, 1e-5], restarts=4)
    assert result.converged.dtype == torch.bool
    assert not result.converged[0]
    monkeypatch.setattr(blahut_arimoto, "NEWTON_CAP", 2)
    with pytest.warns(UserWarning, match="rate_distortion: 1 of 1 solves"):
        single = rate_distortion(PREDATOR_PREY, None, 3.0)
    assert single.converged is False
    assert single.gap > 1e-12
    monkeypatch.undo()
    assert single.upper_bound >= rate_distortion(PREDATOR_PREY, None, 3.0).objective


def test_same_seed_same_result():
    first, second = (serial(MUGS, None, 4, 2.0, 3.0, restarts=5, seed=7) for _ in range(2))
    assert torch.equal(first.optima, second.optima)
    assert torch.equal(first.percept_given_state, second.percept_given_state)
    assert first.optima.shape == (5,)


# Batches of prices


def test_batched_prices_equal_single_solves():
    utilities, prior = random_problem(5, 6, seed=5)
    betas = torch.tensor([[0.3, 2.0, 1e6], [9.0, 40.0, 1e-6]], dtype=torch.float64)
    batch = rate_distortion(utilities, prior, betas)
    assert batch.action_given_state.shape == (2, 3, 5, 6)
    assert batch.action_marginal.shape == (2, 3, 6)
    for i, j in np.ndindex(2, 3):
        assert_same(batch, rate_distortion(utilities, prior, betas[i, j]), (i, j))


def test_serial_prices_broadcast_and_equal_single_solves():
    utilities, prior = random_problem(5, 4, seed=6)
    beta_1, beta_2 = torch.tensor([[2.0], [20.0]]), torch.tensor([3.0, 8.0, 1e5])
    batch = serial(utilities, prior, 6, beta_1, beta_2, restarts=6)
    assert batch.optima.shape == (2, 3, 6)
    assert batch.percept_given_state.shape == (2, 3, 5, 6)
    assert batch.action_given_percept.shape == (2, 3, 6, 4)
    for i, j in np.ndindex(2, 3):
        single = serial(utilities, prior, 6, beta_1[i, 0], beta_2[j], restarts=6)
        assert_same(batch, single, (i, j))


def assert_same(batch, single, index):
    for field in dataclasses.fields(batch):
        ours = torch.as_tensor(getattr(batch, field.name))[index]
        theirs = torch.as_tensor(getattr(single, field.name), dtype=ours.dtype)
        # Different batch sizes round differently, which may cost an iteration more or less.
        if field.name != "iterations":
            torch.testing.assert_close(ours, theirs, atol=1e-6, rtol=0, msg=field.name)


def test_types_of_the_results():
    prior = np.array([0.5, 0.5], dtype=np.float32)
    single = rate_distortion(torch.eye(2, dtype=torch.float32), prior, 2)
    chain = serial(np.eye(2), (0.5, 0.5), np.int64(2), np.float64(3.0), torch.tensor(4))
    for result, kind in ((single, RateDistortion), (chain, Serial)):
        assert type(result) is kind
        assert type(result.converged) is bool
        assert type(result.iterations) is int
        assert type(result.objective) is type(result.upper_bound) is float
        with pytest.raises(dataclasses.FrozenInstanceError):
            result.objective = 0.0
    one_price = rate_distortion(IDENTITY, None, [2.0])
    assert one_price.objective.shape == one_price.converged.shape == (1,)


def test_inputs_stay_out_of_the_graph_and_unchanged():
    utilities = torch.eye(2, dtype=torch.float64).requires_grad_()
    result = serial(utilities, torch.tensor([0.3, 0.7]), 2, 3.0, 3.0)
    assert not result.action_given_state.requires_grad
    assert torch.equal(utilities, torch.eye(2, dtype=torch.float64))


# Invariants


@pytest.mark.parametrize("constant", [-7.0, 1e3, 1e9])
def test_a_constant_is_added_to_the_objective(constant):
    utilities, prior = random_problem(4, 4, seed=8)
    tolerance = 1e-15 * abs(constant) * 4 + 1e-10
    for solve in (
        lambda u: rate_distortion(u, prior, 3.0),
        lambda u: serial(u, prior, 3, 6.0, 6.0),
    ):
        plain, shifted = solve(utilities), solve(utilities + constant)
        assert shifted.objective == pytest.approx(plain.objective + constant, abs=tolerance)
        assert shifted.end_to_end_information == pytest.approx(
            plain.end_to_end_information, abs=1e-5
        )


@pytest.mark.parametrize("factor", [1e-6, 0.1, 1e6])
def test_scaling_utilities_and_prices_scales_the_objective(factor):
    utilities, prior = random_problem(4, 4, seed=9)
    plain, scaled = (serial(c * utilities, prior, 3, 6.0 / c, 9.0 / c) for c in (1.0, factor))
    assert scaled.converged
    assert scaled.objective / factor == pytest.approx(plain.objective, rel=1e-9)
    assert scaled.perception_information == pytest.approx(plain.perception_information, abs=1e-5)
    one, other = (rate_distortion(c * utilities, prior, 6.0 / c) for c in (1.0, factor))
    assert other.objective / factor == pytest.approx(one.objective, rel=1e-12)
    assert other.gap <= 1e-12 * factor


def test_names_of_states_and_actions_do_not_matter():
    utilities, prior = random_problem(5, 4, seed=10)
    rows, columns = [3, 0, 4, 1, 2], [2, 3, 0, 1]
    plain = serial(utilities, prior, 4, 5.0, 9.0)
    renamed = serial(utilities[rows][:, columns], prior[rows], 4, 5.0, 9.0)
    assert renamed.objective == pytest.approx(plain.objective, abs=1e-10)
    one = rate_distortion(utilities, prior, 5.0)
    other = rate_distortion(utilities[rows][:, columns], prior[rows], 5.0)
    torch.testing.assert_close(
        other.action_given_state, one.action_given_state[rows][:, columns], atol=1e-7, rtol=0
    )


# Edges


@pytest.mark.parametrize(
    ("utilities", "prior", "percepts"),
    [
        (ROUGH, [0.5, 0.5], 2),
        (ONE_STATE, [1.0], 3),
        (ONE_ACTION, [0.25, 0.75], 2),
        ([[2.0]], [1.0], 1),
        (IDENTITY, [1.0, 0.0], 2),
        (PREDATOR_PREY, [0.0, 0.5, 0.0, 0.1, 0.0, 0.0, 0.4, 0.0, 0.0], 13),
        (PREDATOR_PREY, [1 / 9] * 9, 1),
        (MUGS, [0.25] * 4, 11),
        ([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.5, 0.5], 5),
        ([[1.0, 1.0], [1.0, 1.0]], [0.5, 0.5], 2),
        ([[1e9, 1e9 - 1], [3.0, 4.0]], [0.5, 0.5], 2),
        ([[1.0, 0.0], [0.0, -1e9]], [1e-12, 1 - 1e-12], 2),
    ],
)
def test_edges_at_all_prices(utilities, prior, percepts):
    for beta in (1e-6, 1e-2, 1.0, 1e3, 1e6):
        result = rate_distortion(utilities, prior, beta)
        assert result.converged
        assert_consistent(result, prior, [beta])
    for betas in ((1e-6, 1e-6), (1e-6, 1e6), (1e6, 1e-6), (1e6, 1e6), (0.7, 2.0), (1e3, 1e-2)):
        result = serial(utilities, prior, percepts, *betas, restarts=7)
        assert result.converged
        assert_consistent(result, prior, betas)


def test_state_without_mass_changes_nothing():
    utilities, prior = random_problem(4, 4, seed=11)
    extended = np.vstack([utilities, [[1e5, -1e5, 0.0, 3.0]]])
    padded = [*prior, 0.0]
    assert rate_distortion(extended, padded, 4.0).objective == pytest.approx(
        rate_distortion(utilities, prior, 4.0).objective, abs=1e-12
    )
    assert serial(extended, padded, 4, 6.0, 6.0).objective == pytest.approx(
        serial(utilities, prior, 4, 6.0, 6.0).objective, abs=1e-10
    )


def test_one_percept_is_a_constant_policy():
    result = serial(PREDATOR_PREY, None, 1, 8.0, 10.0)
    best = torch.tensor(PREDATOR_PREY).double().mean(0).max().item()
    assert result.objective == pytest.approx(best, abs=1e-12)
    assert result.end_to_end_information == pytest.approx(0.0, abs=1e-12)


# Refusals


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        ({"utilities": [1.0, 2.0]}, ValueError, r"utilities: got shape \(2,\).*row"),
        ({"utilities": []}, ValueError, "utilities: got shape"),
        ({"utilities": [[]]}, ValueError, "utilities: got shape"),
        ({"utilities": [[1.0, 2.0], [3.0]]}, ValueError, r"utilities: got \[\[1.0.*equal length"),
        ({"utilities": "table"}, TypeError, "utilities: got 'table'"),
        ({"utilities": None}, TypeError, "utilities: got None"),
        ({"utilities": [[1.0, math.nan], [0.0, 1.0]]}, ValueError, "utilities: got NaN"),
        ({"utilities": [[1.0, -math.inf], [0.0, 1.0]]}, ValueError, "large negative utility"),
        ({"prior": [0.5, 0.6]}, ValueError, "prior: .*sum to 1.1.*divide"),
        ({"prior": [1.5, -0.5]}, ValueError, "prior: got -0.5"),
        ({"prior": [math.nan, 1.0]}, ValueError, "prior: got nan"),
        ({"prior": [0.2, 0.3, 0.5]}, ValueError, r"prior: got shape \(3,\), expected \(2,\)"),
        ({"beta": 0.0}, ValueError, "beta: got 0, expected a finite number above 0"),
        ({"beta": -1.0}, ValueError, "beta: got -1"),
        ({"beta": [1.0, math.nan]}, ValueError, "beta: got nan"),
        ({"beta": math.inf}, ValueError, "beta: got inf"),
        ({"beta": []}, ValueError, "beta: got no number"),
        ({"beta": "high"}, TypeError, "beta: got 'high'"),
    ],
)
def test_rate_distortion_refuses(arguments, kind, words):
    accepted = {"utilities": IDENTITY, "prior": [0.5, 0.5], "beta": 1.0}
    with pytest.raises(kind, match=words) as caught:
        rate_distortion(**(accepted | arguments))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        ({"utilities": [[1.0, math.nan]]}, ValueError, "utilities: got NaN"),
        ({"prior": [0.5, 0.6]}, ValueError, "prior: "),
        ({"percepts": 0}, ValueError, "percepts: got 0, expected an integer of at least 1"),
        ({"percepts": 2.0}, TypeError, "percepts: got 2.0"),
        ({"percepts": True}, TypeError, "percepts: got True"),
        ({"restarts": 0}, ValueError, "restarts: got 0"),
        ({"restarts": "many"}, TypeError, "restarts: got 'many'"),
        ({"beta_perception": -2.0}, ValueError, "beta_perception: got -2"),
        ({"beta_action": math.inf}, ValueError, "beta_action: got inf"),
        (
            {"beta_perception": [1.0, 2.0], "beta_action": [1.0, 2.0, 3.0]},
            ValueError,
            r"got shapes \(2,\) and \(3,\)",
        ),
    ],
)
def test_serial_refuses(arguments, kind, words):
    accepted = {
        "utilities": IDENTITY,
        "prior": None,
        "percepts": 2,
        "beta_perception": 1.0,
        "beta_action": 1.0,
    }
    with pytest.raises(kind, match=words) as caught:
        serial(**(accepted | arguments))
    assert "\n" not in str(caught.value)
