"""The marginals p(x) and p(a), and the ways to them."""

import copy
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from torch.distributions import Normal

from bra.chain import Chain
from bra.channels import MLP, Gaussian, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.information import kl_divergence, mutual_information
from bra.marginals import (
    FRESH,
    BatchMarginals,
    ExactMarginals,
    Marginals,
    RunningMarginals,
    default_marginals,
    posterior,
)
from bra.tasks import TableTask, TargetTask, Task, World
from bra.update_rules import ScoreFunction

PRIOR = [0.5, 0.3, 0.2]
NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)


class Drawn(Task):
    """States that cannot be listed."""

    observation_space = NUMBER
    action_space = Discrete(2)

    def sample(self, count, generator):
        state = torch.randn(count, 1, generator=generator)
        return World(state, state)

    def utility(self, state, action):
        return (action == (state[..., 0] > 0)).float()


@pytest.fixture
def task():
    return TableTask(torch.eye(3), prior=PRIOR, observations="index")


def channel(cls, *spaces, **arguments):
    torch.manual_seed(0)
    return cls(*spaces, **arguments)


def batch_of(*states):
    return torch.tensor(states)  # observed as an index


def percept_marginal(marginals, task, perception, batch):
    return marginals.percept(task, perception, perception(batch), torch.device("cpu"))


def test_exact_marginals_are_table_sums(task):
    perception = channel(Table, Discrete(3), Discrete(4))
    action = channel(Table, Discrete(4), Discrete(2))
    marginals = ExactMarginals()
    batch = batch_of(0)  # whatever the batch holds
    percept = percept_marginal(marginals, task, perception, batch)
    expected = torch.tensor(PRIOR) @ perception.logits.softmax(-1)
    assert percept.batch_shape == ()
    torch.testing.assert_close(percept.probs, expected)
    marginal = marginals.action(action, percept)
    torch.testing.assert_close(marginal.probs, expected @ action.logits.softmax(-1))


def test_exact_marginal_of_a_density_is_the_mixture(task):
    perception = channel(Gaussian, Discrete(3), NUMBER)
    percept = percept_marginal(ExactMarginals(), task, perception, batch_of(0))
    points = torch.linspace(-3, 3, 7).unsqueeze(-1)
    densities = torch.stack(
        [perception(torch.tensor(state)).log_prob(points).exp() for state in range(3)], -1
    )
    expected = (densities @ torch.tensor(PRIOR)).log()
    assert percept.batch_shape == ()
    assert percept.event_shape == (1,)
    torch.testing.assert_close(percept.log_prob(points), expected)


def test_action_marginal_of_a_density_is_the_mixture(task):
    perception = channel(Table, Discrete(3), Discrete(2))
    action = channel(Gaussian, Discrete(2), NUMBER)
    marginals = ExactMarginals()
    percept = percept_marginal(marginals, task, perception, batch_of(0))
    marginal = marginals.action(action, percept)
    points = torch.linspace(-3, 3, 7)
    (m_0, m_1), (s_0, s_1) = action.mean.squeeze(-1), 1e-3 + action.log_scale.exp().squeeze(-1)
    p_0, p_1 = percept.probs
    density = p_0 * Normal(m_0, s_0).log_prob(points).exp()
    density = density + p_1 * Normal(m_1, s_1).log_prob(points).exp()
    torch.testing.assert_close(marginal.log_prob(points.unsqueeze(-1)), density.log())


def test_actions_cost_what_integration_says(task):
    # One world and one sample an update: percepts of its own would make I(X;A) cost nothing.
    perception = channel(Gaussian, Discrete(3), NUMBER)
    action = channel(MLP, NUMBER, Discrete(3))
    with torch.no_grad():
        perception.mean.copy_(torch.tensor([[-2.0], [0.0], [3.0]]))
        action.network[-1].weight.mul_(4)
    chain = Chain(task, perception, action, ExactMarginals(), 2.0, 3.0)
    grid = torch.linspace(-9, 10, 2001).unsqueeze(-1)
    with torch.no_grad():
        p_x = percept_marginal(ExactMarginals(), task, perception, batch_of(0))
        weights = (p_x.log_prob(grid).exp() * (grid[1] - grid[0])).double()
        rows = action(grid).probs.double()
    expected = mutual_information(weights, rows).item()
    p_a = weights @ rows
    chi_square = (weights @ (rows - p_a).square() / p_a).sum().item()
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    rule = ScoreFunction(samples=1)
    costs = torch.tensor(
        [rule.loss(chain, task.sample(1, generator))[1].action_information for _ in range(1500)]
    )
    # Six standard errors, failure probability 2e-9.
    error = 6 * costs.std().item() / len(costs) ** 0.5
    assert error < expected / 2
    assert costs.mean().item() == pytest.approx(expected + chi_square / 2 / FRESH, abs=error)


@pytest.mark.parametrize(("decay", "count"), [(0.0, 4), (0.5, 1), (0.9, 1), (0.9, 4)])
def test_what_running_marginals_lose(task, decay, count):
    perception = Table(Discrete(3), Discrete(3))
    with torch.no_grad():  # rows not far apart, since the bias is of first order
        perception.logits.copy_(torch.tensor([[0.4, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.5]]))
    rows = perception.logits.softmax(-1).double().detach()
    p_x = torch.tensor(PRIOR).double() @ rows
    chi_square = (torch.tensor(PRIOR).double() @ (rows - p_x).square() / p_x).sum().item()
    marginals, generator = running(decay, 3), torch.Generator().manual_seed(0)
    batches = task.sample(6000 * count, generator).observation.view(6000, count)
    running_marginals = torch.stack(
        [percept_marginal(marginals, task, perception, batch).probs for batch in batches]
    ).double()
    exact = kl_divergence(rows[batches], p_x)
    found = (exact - kl_divergence(rows[batches], running_marginals[:, None])).mean(1)[200:]
    lost = marginals.information_lost(count) * chi_square
    # Updates go together over 1/(1 − decay) of them; six standard errors, and higher orders.
    error = 6 * found.std().item() * (2 / (1 - decay) / len(found)) ** 0.5
    assert found.mean().item() == pytest.approx(lost, abs=error + 0.1 * lost)
    assert lost > error  # or nothing would be said


def test_batch_marginals_are_the_mean_over_the_batch(task):
    perception = channel(Table, Discrete(3), Discrete(4))
    marginal = percept_marginal(BatchMarginals(), task, perception, batch_of(0, 0, 2, 1))
    expected = torch.tensor([0.5, 0.25, 0.25]) @ perception.logits.softmax(-1)
    torch.testing.assert_close(marginal.probs, expected)


def test_batch_marginal_of_a_density(task):
    perception = channel(Gaussian, Discrete(3), NUMBER)
    marginal = percept_marginal(BatchMarginals(), task, perception, batch_of(0, 2))
    point = torch.tensor([0.3])
    densities = [perception(torch.tensor(state)).log_prob(point).exp() for state in (0, 2)]
    torch.testing.assert_close(marginal.log_prob(point), (sum(densities) / 2).log())


def running(decay=0.98, percepts=4):
    marginals = RunningMarginals(decay)
    marginals.check(None, Discrete(percepts))
    return marginals


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.98, 0.9999])
def test_running_marginals_of_a_constant_are_that_constant(task, decay):
    perception = channel(Table, Discrete(3), Discrete(4))
    marginals, batch = running(decay), batch_of(0, 1)
    expected = probabilities(perception(batch)).mean(0)
    for _ in range(5):
        marginal = percept_marginal(marginals, task, perception, batch)
        # float32 rounding of 1 − d is 6e-8, relative to 1e-4 at the largest decay.
        torch.testing.assert_close(marginal.probs, expected, rtol=1e-3, atol=1e-5)


def test_running_marginals_forget_geometrically(task):
    perception = channel(Table, Discrete(3), Discrete(4))
    rows = perception.logits.softmax(-1).detach()
    marginals = running(0.8)
    for state in (0, 1, 2):
        marginal = percept_marginal(marginals, task, perception, batch_of(state))
    weights = torch.tensor([0.8**2, 0.8, 1.0])
    torch.testing.assert_close(marginal.probs, weights @ rows / weights.sum())
    assert not marginal.probs.requires_grad


def test_running_marginals_round_trip(task):
    perception = channel(Table, Discrete(3), Discrete(4))
    marginals, other = running(), running()
    for state in (0, 1):
        percept_marginal(marginals, task, perception, batch_of(state))
    other.load_state_dict(copy.deepcopy(marginals.state_dict()))
    ways = (marginals, other)
    last = [percept_marginal(way, task, perception, batch_of(2)).probs for way in ways]
    assert torch.equal(*last)
    assert set(marginals.state_dict()) == {"average"}


@pytest.mark.parametrize("decay", [-0.1, 1.0, float("nan")])
def test_bad_decays_are_refused(decay):
    with pytest.raises(ValueError, match=f"less than 1, got {decay}"):
        RunningMarginals(decay)


def test_ways_that_lead_nowhere_are_refused(task):
    with pytest.raises(ValueError, match=r"got Drawn; use BatchMarginals or RunningMarginals"):
        ExactMarginals().check(Drawn(), Discrete(2))
    with pytest.raises(ValueError, match=r"got Box.*; use BatchMarginals, or ExactMarginals"):
        RunningMarginals().check(task, NUMBER)
    ExactMarginals().check(task, NUMBER)
    BatchMarginals().check(Drawn(), NUMBER)


@pytest.mark.parametrize(
    ("make_task", "percept_space", "expected"),
    [
        (partial(TableTask, [[0.0, 1.0]]), Discrete(2), ExactMarginals),
        (partial(TargetTask, [[0.0]]), NUMBER, ExactMarginals),
        (Drawn, Discrete(2), RunningMarginals),
        (Drawn, NUMBER, BatchMarginals),
    ],
)
def test_default_marginals(make_task, percept_space, expected):
    task = make_task()
    marginals = default_marginals(task, percept_space)
    assert type(marginals) is expected
    assert isinstance(marginals, Marginals)
    marginals.check(task, percept_space)


def test_multinomial_perception_has_the_same_marginal_as_its_table(task):
    start = torch.tensor([[1.0, 0, -1], [2, 1, 0]])
    perception = Multinomial(Discrete(3), Discrete(3), start=start)
    marginal = percept_marginal(ExactMarginals(), task, perception, batch_of(0))
    logits = torch.cat([torch.zeros(1, 3), start]).T
    torch.testing.assert_close(marginal.probs, torch.tensor(PRIOR) @ logits.softmax(-1))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_of_percepts_that_no_state_reaches_the_posterior_is_zero(dtype):
    joint = torch.tensor([[0.5, 0.0, 1e-30], [0.5, 0.0, 3e-30]], dtype=dtype)
    found = posterior(joint.log(), joint.log().logsumexp(0))
    expected = torch.tensor([[0.5, 0.0, 0.25], [0.5, 0.0, 0.75]], dtype=dtype)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=0)
