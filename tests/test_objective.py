"""J and its terms against sums written out."""

import math

import numpy as np
import pytest
import torch

from bra.objective import Objective, bits, digits, sampled_objective, table_objective

DOUBLE = torch.float64


def rows(*shape, seed):
    """Random distributions over the last dimension, from sharp to flat."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=DOUBLE).mul(2).softmax(-1)


def random_problem(states=4, percepts=3, actions=5):
    generator = torch.Generator().manual_seed(9)
    utilities = torch.randn((states, actions), generator=generator, dtype=DOUBLE)
    return (
        rows(states, seed=1),
        rows(states, percepts, seed=2),
        rows(percepts, actions, seed=3),
        utilities,
    )


def with_zeros():
    """An impossible state, an unused percept, an unused action and deterministic rows."""
    prior, percepts, actions, utilities = random_problem()
    prior[1] = 0
    percepts[:, 2] = 0
    percepts[0] = torch.tensor([1.0, 0, 0])
    percepts[1] = torch.tensor([0.0, 0, 1])
    actions[:, 4] = 0
    actions[1] = torch.tensor([0.0, 1, 0, 0, 0])
    actions[2] = torch.tensor([0.0, 0, 0, 0, 1])
    return (
        prior / prior.sum(),
        percepts / percepts.sum(-1, keepdim=True),
        actions / actions.sum(-1, keepdim=True),
        utilities,
    )


def constant_channels():
    prior, percepts, actions, utilities = random_problem()
    return prior, percepts[:1].expand(4, 3), actions[:1].expand(3, 5), utilities


def by_hand(prior, percepts, actions, utilities):
    """E[U], I(Ω;X), I(X;A), I(Ω;A) by double loops over numpy arrays."""
    prior, percepts, actions, utilities = map(np.asarray, (prior, percepts, actions, utilities))
    states, count = percepts.shape
    percept_marginal = [sum(prior[w] * percepts[w, x] for w in range(states)) for x in range(count)]
    behaviour = np.zeros_like(utilities)
    for w in range(states):
        for a in range(actions.shape[1]):
            behaviour[w, a] = sum(percepts[w, x] * actions[x, a] for x in range(count))

    def information(source, channel):
        total = 0.0
        for c in range(len(source)):
            for y in range(channel.shape[1]):
                marginal = sum(source[k] * channel[k, y] for k in range(len(source)))
                if source[c] * channel[c, y] > 0:
                    total += source[c] * channel[c, y] * math.log(channel[c, y] / marginal)
        return total

    utility = sum(
        prior[w] * behaviour[w, a] * utilities[w, a]
        for w in range(states)
        for a in range(utilities.shape[1])
    )
    return (
        utility,
        information(prior, percepts),
        information(percept_marginal, actions),
        information(prior, behaviour),
    )


@pytest.mark.parametrize("problem", [random_problem, with_zeros, constant_channels])
@pytest.mark.parametrize(("beta_1", "beta_2"), [(8.0, 10.0), (0.5, 3.0)])
def test_table_objective_is_the_sum_by_hand(problem, beta_1, beta_2):
    tables = problem()
    utility, first, second, both = by_hand(*tables)
    terms = table_objective(*tables, beta_1, beta_2).item()
    assert terms.expected_utility == pytest.approx(utility, abs=1e-12)
    assert terms.perception_information == pytest.approx(first, abs=1e-12)
    assert terms.action_information == pytest.approx(second, abs=1e-12)
    assert terms.end_to_end_information == pytest.approx(both, abs=1e-12)
    expected = utility - first / beta_1 - second / beta_2
    assert terms.objective == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("problem", [random_problem, with_zeros])
def test_information_does_not_grow_along_the_chain(problem):
    terms = table_objective(*problem(), 1.0, 1.0).item()
    least = min(terms.perception_information, terms.action_information)
    assert 0 <= terms.end_to_end_information <= least


@pytest.mark.parametrize("problem", [random_problem, with_zeros, constant_channels])
def test_gradients_are_finite(problem):
    prior, percepts, actions, utilities = problem()
    percepts, actions = percepts.clone().requires_grad_(), actions.clone().requires_grad_()
    table_objective(prior, percepts, actions, utilities, 2.0, 3.0).objective.backward()
    assert percepts.grad.isfinite().all()
    assert actions.grad.isfinite().all()


def test_gradient_is_the_difference_quotient():
    prior, percepts, actions, utilities = random_problem()

    def objective(percept_logits, action_logits):
        tables = percept_logits.softmax(-1), action_logits.softmax(-1)
        return table_objective(prior, *tables, utilities, 2.0, 3.0).objective

    logits = [table.log().requires_grad_() for table in (percepts, actions)]
    assert torch.autograd.gradcheck(objective, logits)


def test_serial_binary_symmetric_optimum():
    # Closed form: logit q₁ = β₁(2q₂ − 1), logit q₂ = β₂(2q₁ − 1).
    q_1 = q_2 = 0.9
    for _ in range(200):
        q_1, q_2 = (1 / (1 + math.exp(-3 * (2 * q - 1))) for q in (q_2, q_1))
    logits = [
        torch.tensor([[0.0, -gain], [-gain, 0.0]], dtype=DOUBLE, requires_grad=True)
        for gain in (3 * (2 * q_2 - 1), 3 * (2 * q_1 - 1))
    ]
    prior, utilities = torch.full((2,), 0.5, dtype=DOUBLE), torch.eye(2, dtype=DOUBLE)
    tables = (table.softmax(-1) for table in logits)
    terms = table_objective(prior, *tables, utilities, 3.0, 3.0)
    terms.objective.backward()
    values = terms.detach().item()
    assert values.expected_utility == pytest.approx(0.86856232, abs=1e-8)
    assert values.perception_information == pytest.approx(0.43764932, abs=1e-8)
    assert values.action_information == pytest.approx(0.43764932, abs=1e-8)
    assert values.objective == pytest.approx(0.57679611, abs=1e-8)
    for table in logits:  # an optimum is stationary
        assert table.grad.abs().max() < 1e-12


def test_objective_is_the_mean_of_the_sampled_objective():
    prior, percepts, actions, utilities = random_problem()
    percept_marginal, action_marginal = prior @ percepts, prior @ percepts @ actions
    shape = (4, 3, 5)
    j = sampled_objective(
        utilities[:, None, :].expand(shape),
        (percepts / percept_marginal).log()[:, :, None].expand(shape),
        (actions / action_marginal).log().expand(shape),
        2.0,
        3.0,
    )
    assert j.shape == shape
    weights = prior[:, None, None] * percepts[:, :, None] * actions
    expected = table_objective(prior, percepts, actions, utilities, 2.0, 3.0).objective
    torch.testing.assert_close((weights * j).sum(), expected, rtol=0, atol=1e-12)


def test_item_gives_python_floats():
    terms = Objective(*(torch.tensor(value) for value in (1.0, 2.0, 0.5, 0.25)))
    assert terms.item() == Objective(1.0, 2.0, 0.5, 0.25, None)
    assert all(type(value) is float for value in list(vars(terms.item()).values())[:4])


def test_item_takes_tensors_of_a_graph():
    utilities = torch.ones(4, 5, dtype=DOUBLE, requires_grad=True)
    terms = table_objective(*random_problem()[:3], utilities, 2.0, 3.0)
    assert terms.item().expected_utility == pytest.approx(1.0)


@pytest.mark.parametrize(("nats", "expected"), [(0.0, 0.0), (math.log(2), 1.0), (1.0, 1.442695)])
def test_bits(nats, expected):
    assert bits(nats) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.407123, None, "0.40712"),
        (0.407123, 0.0, "0.40712"),
        (0.407123, 0.0032, "0.407 ± 0.003"),
        (12.3456, 0.4, "12.3 ± 0.4"),
        (12.3456, 2.1, "12 ± 2"),
        (0.399254123, 1e-6, "0.39925"),
    ],
)
def test_no_more_digits_than_are_known(value, error, text):
    assert digits(value, error) == text
