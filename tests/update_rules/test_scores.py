"""Scores and losses of the score-function rule, by hand."""

import pytest
import torch
from chains_by_hand import CHAINS, PRIOR, flat_gradient, make_chain
from gymnasium.spaces import Discrete

from bra.channels import MLP, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.tasks import PredatorPrey
from bra.update_rules import ScoreFunction


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
