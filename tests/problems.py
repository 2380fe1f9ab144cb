"""Problems that the tests share, and what holds for every solution."""

import math

import numpy as np
import pytest
import torch

from bra.blahut_arimoto import RateDistortion
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
