"""The gradients of the rules: the paper's formulas, and the gradient of J itself."""

import math

import pytest
import torch
from chains_by_hand import (
    CHAINS,
    PRIOR,
    SIGNALS,
    UTILITIES,
    flat_gradient,
    make_chain,
)
from gymnasium.spaces import Discrete

from bra.channels import Table
from bra.objective import table_objective
from bra.tasks import TableTask
from bra.update_rules import Chain, ExactGradient, ScoreFunction


def sampled_gradients(chain, rule, batches=100, size=2000, seed=0):
    """Gradients of the loss in independent batches, (batches, parameters)."""
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    return torch.stack(
        [
            flat_gradient(rule.loss(chain, chain.task.sample(size, generator))[0], chain)
            for _ in range(batches)
        ]
    )


def quadrature_table(distribution, grid):
    """A density on a fine grid as a table of probabilities, differentiable."""
    log_density = distribution.log_prob(grid.unsqueeze(1)).double()
    return log_density.T.softmax(-1)


def exact_gradient(chain):
    """Gradient of −J by autograd; densities are integrated on a grid."""
    grid = torch.linspace(-9, 9, 3001).unsqueeze(-1)
    task, percept_given = chain.task, chain.perception(chain.task.observations)
    if isinstance(chain.perception.outcome_space, Discrete):
        percepts, first = percept_given.enumerate_support(False).flatten(), percept_given.probs
    else:
        percepts, first = grid, quadrature_table(percept_given, grid)
    action_given = chain.action(percepts)
    if isinstance(task.action_space, Discrete):
        second, utilities = action_given.probs, task.utilities
    else:
        second = quadrature_table(action_given, grid)
        utilities = -(task.targets - grid.T).square().double()
    terms = table_objective(task.prior, first.double(), second.double(), utilities, 2.0, 3.0)
    return flat_gradient(-terms.objective, chain)


@pytest.mark.parametrize("name", CHAINS)
def test_score_function_follows_the_gradient_of_j(name):
    # The mean over 100 batches of 2000 is to agree with autograd within six standard errors in
    # every coordinate (at most 100 of them). Student's t with 99 degrees of freedom: failure
    # probability 3e-6 per chain.
    chain = make_chain(*CHAINS[name])
    expected = exact_gradient(chain)
    gradients = sampled_gradients(chain, ScoreFunction())
    error = gradients.std(0) / math.sqrt(len(gradients))
    assert expected.norm() > 8 * error.norm()  # or the comparison would say little
    difference = (gradients.mean(0) - expected).abs()
    # Sampled p(a) over continuous percepts is biased by O(1/2000), float32 by less.
    assert (difference < 6 * error + 1e-3).all(), (difference / error).max()


@pytest.mark.parametrize(
    "rule",
    [
        ScoreFunction(baseline="running"),
        ScoreFunction(samples=4, baseline="leave-one-out"),
        ScoreFunction(samples=4),
    ],
    ids=["running", "leave-one-out", "samples"],
)
def test_baselines_leave_the_mean_alone(rule):
    # As above: failure probability 2e-6 per rule.
    chain = make_chain(*CHAINS["network of the paper"])
    gradients = sampled_gradients(chain, rule, size=2000 // rule.samples)
    error = gradients.std(0) / math.sqrt(len(gradients))
    difference = (gradients.mean(0) - exact_gradient(chain)).abs()
    assert (difference < 6 * error + 1e-5).all(), (difference / error).max()


def test_baselines_reduce_the_variance():
    # 300 batches of 64 encounters each. Sums of 33 coordinates' variances have relative standard
    # errors of at most sqrt(2/300) = 8 %; half the variance is six of them off.
    shifted = (torch.tensor(UTILITIES) + 4).tolist()
    chain = make_chain(*CHAINS["network of the paper"])
    chain = Chain(
        TableTask(shifted, prior=PRIOR, observations=SIGNALS["vector"]),
        chain.perception,
        chain.action,
        chain.marginals,
        chain.beta_perception,
        chain.beta_action,
    )

    def variance(rule, warm_up=0):
        size = 64 // rule.samples
        gradients = sampled_gradients(chain, rule, batches=300 + warm_up, size=size)
        return gradients[warm_up:].var(0).sum().item()

    none = variance(ScoreFunction())
    assert variance(ScoreFunction(baseline="running"), warm_up=1) < none / 2
    four = variance(ScoreFunction(samples=4))
    assert variance(ScoreFunction(samples=4, baseline="leave-one-out")) < four / 2


@pytest.mark.parametrize("rule", [ScoreFunction(), ScoreFunction(samples=3), ExactGradient()])
def test_the_loss_comes_with_the_terms_of_j(rule):
    chain = make_chain(Table, Table)
    torch.manual_seed(0)
    world = chain.task.sample(50, torch.Generator().manual_seed(0))
    loss, terms = rule.loss(chain, world)
    assert loss.shape == ()
    expected = (
        terms.expected_utility - terms.perception_information / 2 - terms.action_information / 3
    )
    torch.testing.assert_close(terms.objective, expected)
    # They outlive the update, the graph must not.
    assert not terms.objective.requires_grad


def test_sampled_terms_are_the_expected_ones():
    # 200 000 encounters; standard deviations of all terms are below 1.5, six standard errors 0.02:
    # failure probability 1e-8.
    chain = make_chain(Table, Table)
    exact = ExactGradient().loss(chain, chain.task.states())[1]
    torch.manual_seed(0)
    world = chain.task.sample(200_000, torch.Generator().manual_seed(0))
    terms = ScoreFunction().loss(chain, world)[1]
    names = ("objective", "expected_utility", "perception_information", "action_information")
    for name in names:
        expected = getattr(exact, name).item()
        assert getattr(terms, name).item() == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gaussian actions", "needs a FiniteTask, got TargetTask"),
        ("gaussian percepts", "needs percepts that can be enumerated, got Box"),
    ],
)
def test_exact_gradient_refuses_what_it_cannot_sum(name, message):
    with pytest.raises(ValueError, match=rf"{message}.*; use ScoreFunction"):
        ExactGradient().check(make_chain(*CHAINS[name]))


def test_exact_gradient_does_not_look_at_the_batch():
    chain = make_chain(Table, Table)
    losses = [
        ExactGradient().loss(chain, chain.task.sample(5, torch.Generator().manual_seed(seed)))[0]
        for seed in range(2)
    ]
    assert torch.equal(*losses)
    gradient = flat_gradient(losses[0], chain)
    torch.testing.assert_close(gradient, exact_gradient(chain), rtol=1e-4, atol=1e-6)
