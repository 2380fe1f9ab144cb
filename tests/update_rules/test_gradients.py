"""The gradients of the rules: the paper's formulas, and the gradient of J itself."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.marginals import ExactMarginals
from bra.objective import table_objective
from bra.tasks import PredatorPrey, TableTask, TargetTask
from bra.update_rules import Chain, ExactGradient, ScoreFunction

NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)
UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]
PRIOR = [0.5, 0.3, 0.2]
SIGNALS = {
    "index": "index",
    "vector": [[0.0, 1.0], [1.0, 0.0], [1.0, 1.0]],
    "image": torch.randn(3, 1, 3, 3, generator=torch.Generator().manual_seed(0)),
}
TARGETS = [[-1.0], [0.5], [2.0]]
START = torch.randn(2, 3, generator=torch.Generator().manual_seed(1))


def make_chain(perception, action, percepts=None, signals="index", target=False):
    arguments = {"prior": PRIOR, "observations": SIGNALS[signals]}
    task = TargetTask(TARGETS, **arguments) if target else TableTask(UTILITIES, **arguments)
    percepts = percepts or Discrete(3)
    torch.manual_seed(2)
    first = perception(task.observation_space, percepts)
    second = action(percepts, task.action_space)
    return Chain(task, first, second, ExactMarginals(), 2.0, 3.0)


def parameters(chain):
    return [*chain.perception.parameters(), *chain.action.parameters()]


def flat_gradient(loss, chain):
    gradients = torch.autograd.grad(loss, parameters(chain))
    return torch.cat([gradient.flatten() for gradient in gradients]).double()


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


CHAINS = {
    "network of the paper": (partial(MLP, hidden=[5], bias=False), Multinomial, None, "vector"),
    "network and network": (partial(MLP, hidden=[4]), MLP, None, "vector"),
    "table and table": (Table, Table),
    "table and multinomial": (Table, partial(Multinomial, reference=1, start=START)),
    "multinomial and table": (partial(Multinomial, start=START), Table),
    "convolutions": (partial(CNN, channels=[2]), Table, None, "image"),
    "gaussian percepts": (Gaussian, partial(MLP, hidden=[4]), NUMBER),
    "network to gaussian percepts": (MLP, partial(MLP, hidden=[4]), NUMBER, "vector"),
    "gaussian actions": (Table, Gaussian, None, "index", True),
    "network to gaussian actions": (Table, partial(MLP, hidden=[]), None, "index", True),
}


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


def test_running_baseline_is_known_before_the_update():
    chain = make_chain(Table, Table)
    rule, plain = ScoreFunction(baseline="running"), ScoreFunction()
    generator = torch.Generator().manual_seed(0)
    weighted, weight = 0.0, 0.0
    for k in range(4):
        world = chain.task.sample(50, generator)
        torch.manual_seed(k)
        loss, terms = rule.loss(chain, world)
        torch.manual_seed(k)
        plain_loss, _ = plain.loss(chain, world)
        torch.manual_seed(k)
        percept_given = chain.perception(world.observation)
        percept = chain.draw(percept_given, (1,))[0]
        action_given = chain.action(percept)
        scores = percept_given.log_prob(percept) + action_given.log_prob(chain.draw(action_given))
        known = weighted / weight if weight else 0.0
        torch.testing.assert_close(loss, plain_loss + known * scores.mean(), rtol=1e-4, atol=1e-5)
        weighted = 0.99 * weighted + 0.01 * terms.objective.item()
        weight = 0.99 * weight + 0.01


def test_leave_one_out_by_hand():
    chain = make_chain(Table, Table)
    world = chain.task.sample(2, torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    loss, _ = ScoreFunction(samples=3, baseline="leave-one-out").loss(chain, world)
    torch.manual_seed(0)
    percept_given = chain.perception(world.observation)
    percept = chain.draw(percept_given, (3,))
    action_given = chain.action(percept.flatten())
    action = chain.draw(action_given)
    with torch.no_grad():
        p_x = torch.tensor(PRIOR) @ chain.perception(chain.task.observations).probs
        p_a = p_x @ chain.action(torch.arange(3)).probs
    perception_score = percept_given.log_prob(percept)
    action_score = action_given.log_prob(action).reshape(3, 2)
    j = (
        chain.task.utility(world.state.repeat(3), action).float().reshape(3, 2)
        - (perception_score - p_x.log()[percept]) / chain.beta_perception
        - (action_score - p_a.log()[action].reshape(3, 2)) / chain.beta_action
    ).detach()
    others = torch.stack([(j[1] + j[2]) / 2, (j[0] + j[2]) / 2, (j[0] + j[1]) / 2])
    expected = -((perception_score + action_score) * (j - others)).mean()
    torch.testing.assert_close(loss, expected)


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 0}, "samples must be a whole number of at least 1, got 0"),
        ({"samples": 1.5}, "samples must be a whole number of at least 1, got 1.5"),
        ({"baseline": "mean"}, "none, running or leave-one-out, got 'mean'"),
        ({"baseline": "leave-one-out"}, "needs samples ≥ 2, got 1"),
    ],
)
def test_bad_settings_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ScoreFunction(**arguments)


def paper_perception():
    """V, W of a network of the paper's size, and the channel that has them, in float64."""
    task = PredatorPrey()
    torch.manual_seed(0)
    channel = MLP(task.observation_space, Discrete(13), hidden=[20], bias=False).double()
    v, w = (weight.detach().T for weight in channel.parameters())
    return channel, v, w, task.observations.double()


@pytest.mark.parametrize("i", [0, 5, 12])
@pytest.mark.parametrize("state", range(0, 9, 2))
def test_perception_score_is_that_of_the_appendix(i, state):
    channel, v, w, signals = paper_perception()
    signal = signals[state]
    score = channel(signal).log_prob(torch.tensor(i))
    by_v, by_w = (g.T for g in torch.autograd.grad(score, list(channel.parameters())))

    hidden = torch.tanh(signal @ v)
    slope = 1 - hidden**2
    p = torch.softmax(hidden @ w, -1)
    expected_v = torch.outer(signal, slope * w[:, i])
    for k in range(13):
        expected_v -= p[k] * torch.outer(signal, slope * w[:, k])
    expected_w = torch.stack(
        [(1 - p[j]) * hidden if j == i else -p[j] * hidden for j in range(13)], -1
    )
    torch.testing.assert_close(by_v, expected_v, rtol=0, atol=1e-10)
    torch.testing.assert_close(by_w, expected_w, rtol=0, atol=1e-10)


@pytest.mark.parametrize("action", range(4))
def test_action_score_is_that_of_the_paper(action):
    generator = torch.Generator().manual_seed(0)
    eta = torch.randn(3, 2, generator=generator, dtype=torch.float64)
    channel = Multinomial(Discrete(2), Discrete(4), start=eta).double()
    with torch.no_grad():
        channel.eta.copy_(eta)
    percept = 1
    score = channel(torch.tensor(percept)).log_prob(torch.tensor(action))
    (gradient,) = torch.autograd.grad(score, [channel.eta])
    # ∂/∂η_i^x log p(a|x) = a_i − p(a_i|x), and nothing for other percepts.
    expected = torch.zeros(3, 2, dtype=torch.float64)
    normaliser = 1 + eta[:, percept].exp().sum()
    for i in range(3):
        expected[i, percept] = float(action == i + 1) - eta[i, percept].exp() / normaliser
    torch.testing.assert_close(gradient, expected, rtol=0, atol=1e-10)


def test_loss_is_score_times_objective():
    """One encounter: the gradient is −(∂ log p(x|ξ) + ∂ log p(a|x)) j, as in the paper."""
    chain = make_chain(*CHAINS["network of the paper"])
    task = chain.task
    world = task.sample(1, torch.Generator().manual_seed(0))
    torch.manual_seed(3)
    loss, terms = ScoreFunction().loss(chain, world)
    gradient = flat_gradient(loss, chain)
    torch.manual_seed(3)
    percept_given = chain.perception(world.observation)
    percept = chain.draw(percept_given, (1,))[0]
    action_given = chain.action(percept)
    action = chain.draw(action_given)
    p_x = task.prior.float() @ probabilities(chain.perception(task.observations))
    p_a = p_x @ probabilities(chain.action(torch.arange(3)))
    score = percept_given.log_prob(percept) + action_given.log_prob(action)
    j = (
        task.utilities[world.state, action]
        - (percept_given.log_prob(percept) - p_x[percept].log()) / 2
        - (action_given.log_prob(action) - p_a[action].log()) / 3
    ).detach()
    torch.testing.assert_close(terms.objective.double(), j.squeeze(), rtol=1e-5, atol=1e-6)
    expected = -j * flat_gradient(score.sum(), chain)
    torch.testing.assert_close(gradient, expected, rtol=1e-5, atol=1e-6)
