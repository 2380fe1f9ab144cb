import math

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

from bra.blahut_arimoto import rate_distortion
from bra.blahut_arimoto.mixture_likelihood import GAP_TOLERANCE, MixtureLikelihood, maximise

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


@pytest.mark.parametrize("utilities", [PREDATOR_PREY, MUGS, ROUGH])
def test_low_price_leaves_the_best_constant_action(utilities):
    best = torch.tensor(utilities).double().mean(0).max().item()
    result = rate_distortion(utilities, None, 1e-6)
    assert result.expected_utility == pytest.approx(best, abs=1e-8)


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


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("beta", [0.5, 4.0, 40.0])
def test_one_channel_agrees_with_plain_iteration(seed, beta):
    utilities, prior = random_problem(5, 6, seed)
    result = rate_distortion(utilities, prior, beta)
    assert result.objective == pytest.approx(plain_one_channel(utilities, prior, beta), abs=1e-9)
    assert_consistent(result, prior, [beta])


@pytest.mark.parametrize("beta", [1e-3, 0.5, 20.0])
def test_derivatives_are_those_of_the_value(beta):
    utilities, prior = (torch.as_tensor(x) for x in random_problem(4, 5, seed=2))
    likelihood = MixtureLikelihood(utilities, prior, torch.tensor([beta], dtype=torch.float64))
    q = torch.tensor([[0.1, 0.2, 0.3, 0.25, 0.15]], dtype=torch.float64)
    slope, curvature = likelihood.derivatives(q)
    gradient = torch.autograd.functional.jacobian(likelihood.value, q).view(1, -1)
    hessian = torch.autograd.functional.hessian(lambda q: likelihood.value(q).sum(), q).view(5, 5)
    torch.testing.assert_close(slope, gradient - (q * gradient).sum())
    torch.testing.assert_close(curvature[0], -hessian)


def test_newton_steps_are_few_where_an_action_is_about_to_enter():
    # At its critical price plain Blahut-Arimoto needs some 1e6 sweeps for the same certificate.
    prior = torch.tensor([0.8, 0.2], dtype=torch.float64)
    critical = torch.tensor([math.log(4.0)], dtype=torch.float64)
    found = maximise(MixtureLikelihood(torch.eye(2, dtype=torch.float64), prior, critical))
    assert found.certificate.item() <= GAP_TOLERANCE
    assert found.iterations.item() <= 30


def test_cap_is_reported(monkeypatch):
    monkeypatch.setattr("bra.blahut_arimoto.mixture_likelihood.NEWTON_CAP", 2)
    with pytest.warns(UserWarning, match="rate_distortion: 1 of 1 solves") as caught:
        single = rate_distortion(PREDATOR_PREY, None, 3.0)
    assert caught[0].filename == __file__
    assert single.converged is False
    assert single.gap > 1e-12
    monkeypatch.undo()
    assert single.upper_bound >= rate_distortion(PREDATOR_PREY, None, 3.0).objective
