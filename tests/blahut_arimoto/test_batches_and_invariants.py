import dataclasses

import numpy as np
import pytest
import torch
from problems import IDENTITY, MUGS, PREDATOR_PREY, ROUGH, assert_consistent, random_problem

from bra.blahut_arimoto import RateDistortion, Serial, rate_distortion, serial

ONE_STATE = [[1.0, 3.0, 2.0]]
ONE_ACTION = [[1.0], [4.0]]


# Batches of prices


def assert_same(batch, single, index):
    for field in dataclasses.fields(batch):
        ours = torch.as_tensor(getattr(batch, field.name))[index]
        theirs = torch.as_tensor(getattr(single, field.name), dtype=ours.dtype)
        # Different batch sizes round differently, which may cost an iteration more or less, and
        # change how copies of a percept share its use.
        if field.name not in ("iterations", "percept_given_state", "percept_marginal"):
            torch.testing.assert_close(ours, theirs, atol=1e-6, rtol=0, msg=field.name)


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
    batch = serial(utilities, prior, 6, beta_1, beta_2, restarts=6, budget=6)
    assert batch.optima.shape == (2, 3, 6)
    assert batch.percept_given_state.shape == (2, 3, 5, 6)
    assert batch.action_given_percept.shape == (2, 3, 6, 4)
    for i, j in np.ndindex(2, 3):
        single = serial(utilities, prior, 6, beta_1[i, 0], beta_2[j], restarts=6, budget=6)
        assert_same(batch, single, (i, j))


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
