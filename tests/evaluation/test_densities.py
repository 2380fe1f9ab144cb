"""J of percepts and actions that have densities."""

import math

import pytest
import torch
from evaluated import NAMES, NUMBER, channel, evaluate
from gymnasium.spaces import Discrete

from bra.channels import MLP, Channel, Gaussian, Table
from bra.evaluation.tables import tabulate
from bra.objective import table_objective
from bra.tasks import PredatorPrey, TableTask, TargetTask


def gaussian(means, scales):
    made = Gaussian(Discrete(len(means)), NUMBER)
    with torch.no_grad():
        made.mean.copy_(torch.tensor(means).unsqueeze(-1))
        made.log_scale.copy_((torch.tensor(scales).unsqueeze(-1) - 1e-3).log())
    return made


def replicate(task, perception, action, times=40):
    """Means and standard errors of the terms over independent evaluations."""
    torch.manual_seed(1)
    runs = [evaluate(task, perception, action).objective for _ in range(times)]
    values = {name: torch.tensor([getattr(run, name) for run in runs]) for name in NAMES}
    return {
        name: (value.mean().item(), value.std().item() / math.sqrt(times))
        for name, value in values.items()
    }


def assert_within(found, expected, errors=6.0):
    mean, error = found
    assert error < 0.04  # or the comparison would say nothing
    assert abs(mean - expected) < errors * error + 1e-6


def trapezoid(values, grid):
    return torch.trapezoid(values, grid).item()


def information_of_a_mixture(weights, means, scales):
    """I between component and value by numerical integration."""
    grid = torch.linspace(-30, 30, 60_001, dtype=torch.float64)
    densities = torch.stack(
        [
            torch.exp(-0.5 * ((grid - m) / s) ** 2) / (s * math.sqrt(2 * math.pi))
            for m, s in zip(means, scales, strict=True)
        ]
    )
    marginal = (torch.tensor(weights, dtype=torch.float64) @ densities).clamp_min(1e-300)
    terms = torch.xlogy(densities, densities) - torch.xlogy(densities, marginal)
    return sum(w * trapezoid(term, grid) for w, term in zip(weights, terms, strict=True))


def two_percepts(prior, spread=1.0):
    task = TargetTask([[-1.0], [2.0]], prior=prior, observations="index")
    return task, channel(Table, Discrete(2), Discrete(2), spread=spread)


@pytest.mark.parametrize(
    ("means", "scales"),
    [([0.0, 1.0], [1.0, 1.0]), ([-1.0, 1.5], [0.5, 1.2]), ([0.0, 0.0], [0.2, 2.0])],
)
def test_gaussian_actions_agree_with_numerical_integration(means, scales):
    # 40 evaluations per case, 12 comparisons at six standard errors: failure probability 1e-6
    # (Student's t).
    task, perception = two_percepts([0.3, 0.7])
    found = replicate(task, perception, gaussian(means, scales))
    percept_given = perception(torch.arange(2)).probs.detach().double()
    weights = (task.prior @ percept_given).tolist()
    assert_within(found["action_information"], information_of_a_mixture(weights, means, scales))
    utility = -sum(
        task.prior[w].item()
        * percept_given[w, x].item()
        * ((task.targets[w, 0].item() - means[x]) ** 2 + scales[x] ** 2)
        for w in range(2)
        for x in range(2)
    )
    assert_within(found["expected_utility"], utility, errors=6)
    # Perception is a table: exact.
    exact = table_objective(
        task.prior, percept_given, torch.ones(2, 1).double(), torch.ones(2, 1).double(), 1, 1
    ).item()
    mean, error = found["perception_information"]
    assert mean == pytest.approx(exact.perception_information, abs=1e-6)
    assert error < 1e-7


@pytest.mark.parametrize("count", [2, 5, 16])
def test_far_apart_actions_carry_log_n(count):
    targets = 100.0 * torch.arange(count).unsqueeze(-1)
    task = TargetTask(targets, observations="index")
    perception = Table(Discrete(count), Discrete(count))
    with torch.no_grad():
        perception.logits.copy_(100 * torch.eye(count))
    torch.manual_seed(0)
    action = gaussian(targets.flatten().tolist(), [0.5] * count)
    terms = evaluate(task, perception, action).objective
    for name in NAMES[2:]:
        assert getattr(terms, name) == pytest.approx(math.log(count), abs=1e-6)
    # A mean of 2048 squared normals, variance 2: six standard errors, failure probability 2e-9.
    assert terms.expected_utility == pytest.approx(-0.25, abs=6 * 0.25 * math.sqrt(2 / 2048))


@pytest.mark.parametrize("component", [[0.0, 0.0], [3.0, 3.0]])
def test_equal_components_carry_nothing(component):
    task, perception = two_percepts([0.5, 0.5])
    torch.manual_seed(0)
    terms = evaluate(task, perception, gaussian(component, [1.0, 1.0])).objective
    assert terms.action_information == pytest.approx(0, abs=1e-9)
    assert terms.end_to_end_information == pytest.approx(0, abs=1e-9)


class Threshold(Channel):
    """Action 1 where the percept is large."""

    def forward(self, condition):
        logit = 2 * condition[..., 0]
        return torch.distributions.Categorical(
            logits=torch.stack([torch.zeros_like(logit), logit], -1)
        )


def test_gaussian_percepts_agree_with_numerical_integration():
    # 40 evaluations, four comparisons at six standard errors: failure probability under 1e-5.
    means, scales = [-1.0, 0.5], [0.7, 1.0]
    task = TableTask([[1.0, 0.0], [-1.0, 2.0]], prior=[0.4, 0.6], observations="index")
    perception, action = gaussian(means, scales), Threshold(NUMBER, Discrete(2))
    found = replicate(task, perception, action)
    grid = torch.linspace(-9, 9, 4001, dtype=torch.float64).unsqueeze(-1)
    with torch.no_grad():
        density = torch.stack([perception(torch.tensor(w)).log_prob(grid).exp() for w in range(2)])
        table = density / density.sum(-1, keepdim=True)
        exact = table_objective(
            task.prior, table, action(grid).probs, task.utilities, 2.0, 3.0
        ).item()
    for name in NAMES:
        assert_within(found[name], getattr(exact, name))


def test_gaussian_perception_into_a_network_is_sensible():
    task = PredatorPrey(observations="index")
    perception = channel(Gaussian, Discrete(9), NUMBER, scale=0.5)
    action = channel(MLP, NUMBER, task.action_space, seed=1)
    torch.manual_seed(0)
    found = evaluate(task, perception, action)
    terms = found.objective
    assert not found.exact
    assert 0 < terms.perception_information <= math.log(9)
    least = min(terms.perception_information, terms.action_information)
    assert 0 < terms.end_to_end_information <= least
    assert 0 <= terms.expected_utility <= 5
    torch.testing.assert_close(found.action_given_state.sum(-1), torch.ones(9).double())


def test_gaussian_percepts_and_actions_together(monkeypatch):
    # Time goes with the square of the points. 20 evaluations, four comparisons at six standard
    # errors: failure probability 4e-5 (Student's t with 19 degrees of freedom).
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 400)
    task = TargetTask([[-1.0], [2.0]], observations="index")
    perception = gaussian([-3.0, 3.0], [0.5, 0.5])
    action = channel(MLP, NUMBER, NUMBER, hidden=[])
    with torch.no_grad():
        action.network[0].weight.copy_(torch.tensor([[1.0], [0.0]]))
        action.network[0].bias.copy_(torch.tensor([0.0, math.log(0.5 - 1e-3)]))
    # a = x + noise: a normal channel, all in closed form: a − m_ω has variance ½.
    found = replicate(task, perception, action, times=20)
    means = [-3.0, 3.0]
    scale = math.sqrt(0.5)
    assert_within(
        found["end_to_end_information"],
        information_of_a_mixture([0.5, 0.5], means, [scale, scale]),
    )
    assert_within(
        found["perception_information"], information_of_a_mixture([0.5, 0.5], means, [0.5, 0.5])
    )
    # I(X;A) = H(A) − H(A|X).
    grid = torch.linspace(-30, 30, 60_001, dtype=torch.float64)
    density = sum(torch.exp(-((grid - m) ** 2)) / math.sqrt(math.pi) / 2 for m in means)
    entropy = -trapezoid(torch.xlogy(density, density), grid)
    expected = entropy - 0.5 * math.log(2 * math.pi * math.e * 0.25)
    mean, error = found["action_information"]
    # Monte Carlo over 2048 × 2048 points: its own bias of some 1/2048 per effective cell.
    assert abs(mean - expected) < 6 * error + 0.02
    assert_within(found["expected_utility"], -(0.5 + (2.0**2 + 1.0**2) / 2))


@pytest.mark.parametrize("weights", [[0.5, 0.5], [0.9, 0.1], [1.0, 0.0]])
def test_tables_of_densities_have_rows_that_sum_to_one(weights):
    torch.manual_seed(0)
    weights = torch.tensor(weights).double()
    conditional = gaussian([0.0, 1.0], [1.0, 0.5])(torch.arange(2))
    support, table = tabulate(weights, conditional)
    assert support.shape == (2048, 1)
    torch.testing.assert_close(table.sum(-1), torch.ones(2).double())
    # The marginal of the table puts on every component's points that component's weight.
    massive = weights > 0  # the others have no points
    mass = (weights @ table).reshape(int(massive.sum()), -1).sum(1)
    # Ratios average to one up to Monte Carlo error, 0.05 is more than six standard errors.
    torch.testing.assert_close(mass, weights[massive], rtol=0, atol=0.05)
