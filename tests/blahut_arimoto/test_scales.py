"""Forbidden actions, penalties, utilities and prices of any size: the values stay right."""

import math
import warnings

import numpy as np
import pytest
import torch
from problems import IDENTITY, PREDATOR_PREY, random_problem

from bra.blahut_arimoto import rate_distortion, serial
from bra.blahut_arimoto.reduction import reduced, undominated

TABLE = np.array(PREDATOR_PREY)
PENALTIES = [1e3, 1e8, 1e11, 1e13, 1e100, 1e300, 1.7e308, math.inf]
OTHERS = PENALTIES[2:-2]
TINY_PRICES = [1e-3, 1e-9, 1e-12, 1e-30, 1e-61, 1e-200, 1e-300, 6e-309]
NO_SINGLE_ACTION = [[0.0, -math.inf], [-math.inf, 0.0]]


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def single_action(table, prior=None):
    p = np.full(len(table), 1 / len(table)) if prior is None else prior
    return np.where(p > 0, p, 0) @ np.where(p[:, None] > 0, table, 0)


# Forbidden actions


@pytest.mark.parametrize("penalty", PENALTIES)
def test_a_column_that_is_always_penalised_changes_nothing(penalty):
    barred = np.hstack([TABLE, np.full((9, 1), -penalty)])
    found = serial(barred, None, 3, 8.0, 10.0, budget=32)
    assert found.objective == pytest.approx(3.1864119, abs=1e-7)
    assert found.converged
    assert found.action_given_state[:, 9].max() == 0
    one = rate_distortion(barred, None, 80 / 18)
    assert one.objective == pytest.approx(3.2747529, abs=1e-7)
    assert one.upper_bound == pytest.approx(3.2747529, abs=1e-7)


@pytest.mark.parametrize(
    "penalty", [1e8, *(pytest.param(p, marks=pytest.mark.slow) for p in OTHERS), 1.7e308, math.inf]
)
@pytest.mark.parametrize(
    ("cells", "percepts", "objective", "single"),
    [
        ([(0, 1), (3, 7), (6, 0)], 3, 3.18637701, 3.27457066),
        ([(0, 1), (3, 7), (6, 0)], 13, 3.27048480, 3.27457066),
        (list(zip(range(9), [8, 8, 8, 0, 1, 2, 6, 3, 7], strict=True)), 5, 3.27046906, 3.27404134),
    ],
)
def test_penalised_cells_are_avoided_whatever_the_penalty(
    penalty, cells, percepts, objective, single
):
    table = TABLE.copy()
    rows, columns = zip(*cells, strict=True)
    table[rows, columns] = -penalty
    found = serial(table, None, percepts, 8.0, 10.0, budget=64)
    assert found.objective == pytest.approx(objective, abs=1e-8)
    assert found.converged
    assert found.action_given_state[rows, columns].max() <= 1 / penalty
    assert found.objective <= found.tight_bound <= found.upper_bound
    assert rate_distortion(table, None, 80 / 18).objective == pytest.approx(single, abs=1e-8)


@pytest.mark.parametrize("beta", [1e-300, 1e-6, 2.0, 1e3, 1e300])
def test_states_that_share_no_action_have_to_be_told_apart(beta):
    prior = [0.3, 0.7]
    nats = -0.3 * math.log(0.3) - 0.7 * math.log(0.7)
    one = rate_distortion(NO_SINGLE_ACTION, prior, beta)
    two = serial(NO_SINGLE_ACTION, prior, 2, beta, beta)
    assert one.objective * beta == pytest.approx(-nats, rel=1e-9)
    assert two.objective * beta == pytest.approx(-2 * nats, rel=1e-9)
    assert torch.equal(two.action_given_state, torch.eye(2, dtype=torch.double))


def test_states_without_mass_may_forbid_and_cost_anything():
    table = np.vstack([TABLE, [[-math.inf] * 8 + [1e308]]])
    prior = [*[1 / 9] * 9, 0.0]
    assert serial(table, prior, 13, 8.0, 10.0).objective == pytest.approx(3.27049102, abs=1e-7)
    assert rate_distortion(table, prior, 80 / 18).objective == pytest.approx(3.2747529, abs=1e-7)


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(n, marks=pytest.mark.slow) for n in range(6, 12))]
)
def test_forbidden_actions_as_limit_of_penalties(seed):
    utilities, prior = random_problem(6, 5, seed)
    rng = np.random.default_rng(seed)
    barred = rng.random((6, 5)) < 0.4
    barred[np.arange(6), rng.integers(0, 5, 6)] = False
    values = [
        serial(np.where(barred, -penalty, utilities), prior, 5, 5.0, 9.0, budget=64).objective
        for penalty in (1e7, math.inf)
    ]
    assert values[0] == pytest.approx(values[1], abs=1e-7)


# Prices


@pytest.mark.parametrize("beta", TINY_PRICES)
@pytest.mark.parametrize("other", [None, 1e4])
def test_dear_information_leaves_the_best_single_action(beta, other):
    for table in (TABLE, np.hstack([TABLE, [[-math.inf]] * 3 + [[9.0]] * 6])):
        best = single_action(TABLE).max() - 1e-15  # of another order of the same sum
        found = serial(table, None, 3, beta, other or beta, budget=32)
        assert found.converged
        assert best <= found.objective <= found.tight_bound + 1e-15
        assert found.objective == pytest.approx(best, abs=1e-12)
        one = rate_distortion(table, None, beta)
        assert one.converged
        assert best <= one.objective <= one.upper_bound <= best + 1e-12


@pytest.mark.parametrize("beta", [1e-1, 1e-3, 1e-6, 1e-9])
def test_one_bit_at_a_small_price_is_worth_an_eighth_of_it(beta):
    one = rate_distortion(IDENTITY, None, beta)
    assert one.objective - 0.5 == pytest.approx(beta / 8, rel=1e-2, abs=1e-16)
    assert one.end_to_end_information == pytest.approx(beta**2 / 8, rel=1e-2)


def test_prices_of_all_sizes_in_one_batch():
    beta_1 = torch.tensor([1e-300, 1e-9, 1.0, 8.0, 8.0, 1e300], dtype=torch.double)
    beta_2 = torch.tensor([8.0, 1e-9, 1.0, 10.0, 1e-200, 1e300], dtype=torch.double)
    found = serial(TABLE, None, 13, beta_1, beta_2)
    expected = torch.tensor([2.0, 2.0, 2.0448899, 3.2704910, 2.0, 3.6000000], dtype=torch.double)
    torch.testing.assert_close(found.objective, expected, atol=1e-6, rtol=0)


# Scales


@pytest.mark.parametrize("scale", [1e-300, 1e-100, 1e-6, 1e100, 1e300, 3e307])
def test_utilities_of_any_size(scale):
    found = serial(TABLE * scale, None, 13, 8 / scale, 10 / scale)
    assert found.objective / scale == pytest.approx(3.27049102, abs=1e-7)
    one = rate_distortion(TABLE * scale, None, 80 / 18 / scale)
    assert one.objective / scale == pytest.approx(3.2747529, abs=1e-7)


@pytest.mark.parametrize("shift", [1e8, -1e8, 1e12])
def test_utilities_far_from_zero(shift):
    found = serial(TABLE + shift, None, 13, 8.0, 10.0)
    assert found.objective - shift == pytest.approx(3.27049102, abs=1e-15 * abs(shift) + 1e-7)


@pytest.mark.parametrize("seed", [1, 9, 22])
def test_a_state_that_hardly_occurs_may_forbid_what_others_need(seed):
    rng = np.random.default_rng([6, seed])
    states, actions, percepts = rng.integers(3, 8), rng.integers(3, 8), rng.integers(2, 6)
    table = rng.normal(size=(states, actions))
    betas = np.exp(rng.uniform(np.log(0.5), np.log(20), 2))
    never = rng.random(actions) < 0.5
    never[rng.integers(actions)] = False
    often, rarity = rng.dirichlet(np.ones(states - 1)), 10.0 ** -rng.integers(1, 10)
    prior = [rarity, *(1 - rarity) * often]
    found = []
    for penalty in (1e5, 1e8, 1e11, 1e15, math.inf):
        table[0, never] = -penalty / rarity
        found.append(serial(table, prior, int(percepts), *betas).objective)
    assert found == pytest.approx([max(found)] * 5, abs=1e-5)


@pytest.mark.parametrize("rarity", [1e-6, 1e-8, 1e-10, 1e-13])
def test_a_state_that_hardly_occurs_and_is_worth_much(rarity):
    """Climbs end, and what it is worth is added: it may name its action at next to no cost."""
    rare = [worth / rarity for worth in (0.9, 0.4, -0.1, -0.5, 0.2, -0.4)]
    often = [[-1, 0, 0, -1, -3, 0], [-1, -1, 0, -3, 1, -3], [1, 3, -3, 3, 1, -3]]
    prior = [rarity, *3 * [(1 - rarity) / 3]]
    found = serial([rare, *often], prior, 8, 2.0, 0.1, restarts=8, budget=8)
    assert found.converged and found.iterations < 1000
    assert found.objective <= found.upper_bound
    cost = rarity * math.log(1 / rarity) * (1 / 2.0 + 1 / 0.1)
    assert found.objective == pytest.approx(0.9 + (1 - rarity) * 2 / 3, abs=1.2 * cost)


def test_the_largest_numbers():
    table = [[1.7e308, -1.7e308], [-1.7e308, 1.7e308]]
    assert rate_distortion(table, None, 1e8).objective == 1.7e308
    assert serial(table, None, 2, 1e8, 1e8).objective == 1.7e308
    scaled = rate_distortion([[1.7, -1.7], [-1.7, 1.7]], None, 1.0)
    assert rate_distortion(table, None, 1e-308).objective == pytest.approx(
        1e308 * scaled.objective, rel=1e-12
    )


# The reduction


def test_dominated_actions_and_duplicate_states_go():
    assert undominated(torch.tensor(PREDATOR_PREY)).tolist() == [0, 1, 2, 6, 7, 8]
    assert undominated(torch.tensor([[1.0, 1.0], [2.0, 2.0]])).tolist() == [0]
    beta = torch.tensor([8.0], dtype=torch.double)
    table = torch.tensor(PREDATOR_PREY, dtype=torch.double)
    small = reduced(table, torch.full((9,), 1 / 9, dtype=torch.double), 13, beta, beta)
    assert small.utilities.shape == (5, 6)
    assert sorted(small.prior.tolist()) == pytest.approx([1 / 9] * 3 + [1 / 3] * 2)
    back = small.value(small.utilities[small.state_of])
    torch.testing.assert_close(
        back - back.amax(1, keepdim=True), (table - table.amax(1, keepdim=True))[:, small.kept]
    )


def test_every_optimum_loses_less_than_the_regret_says():
    for seed in range(5):
        utilities, prior = (torch.as_tensor(x) for x in random_problem(6, 5, seed))
        for percepts in (1, 3, 6):
            beta = torch.tensor([0.5, 5.0, 50.0], dtype=torch.double)
            problem = reduced(utilities, prior, percepts, beta, beta)
            found = serial(utilities, prior, percepts, beta, beta, budget=32)
            best = prior @ utilities.amax(1)
            assert (best - found.objective <= problem.unit * problem.regret + 1e-12).all()


@pytest.mark.parametrize("seed", range(40))
def test_no_better_than_the_bounds_no_worse_than_a_single_action(seed):
    rng = np.random.default_rng(seed)
    states, actions, percepts = (int(n) for n in rng.integers(2, 7, 3))
    table, prior = rng.random((states, actions)), rng.dirichlet(np.full(states, 0.3))
    barred = rng.random((states, actions)) < 0.3
    barred[np.arange(states), 0] = False
    table[barred] = -math.inf if seed % 2 else -(10.0 ** rng.uniform(0, 290))
    scale = 10.0 ** rng.choice([-200, -5, 0, 5])
    beta_1, beta_2 = 10.0 ** rng.uniform(-25, 8, 2) / scale
    found = serial(table * scale, prior, percepts, beta_1, beta_2, restarts=8, budget=8)
    assert found.converged
    single = max(prior @ column for column in (table * scale).T)
    size = max(abs(single), abs(found.upper_bound))
    assert single - 1e-14 * size <= found.objective <= found.tight_bound + 1e-12 * size
    assert found.tight_bound <= found.upper_bound
    assert not found.action_given_state[np.isinf(table) & (prior > 0)[:, None]].any()
    assert found.action_given_state.sum(1).tolist() == pytest.approx([1.0] * states)
