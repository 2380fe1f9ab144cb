"""J of given channels: exact where possible, close to the truth where it is estimated."""

import itertools
import math

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra.chain import Chain
from bra.channels import MLP, Channel, Gaussian, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.evaluation import evaluate as evaluate_chain
from bra.evaluation.shortfall import StratifiedSample
from bra.evaluation.tables import tabulate
from bra.marginals import default_marginals
from bra.objective import table_objective
from bra.tasks import FiniteTask, PredatorPrey, TableTask, TargetTask, Task, World

NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)
NAMES = (
    "objective",
    "expected_utility",
    "perception_information",
    "action_information",
    "end_to_end_information",
)
SAMPLED = (*NAMES[:-1], "signal_action_information")
"""The same over sampled worlds, where a signal has one state."""


def channel(cls, *spaces, seed=0, **arguments):
    torch.manual_seed(seed)
    return cls(*spaces, **arguments)


def gaussian(means, scales):
    made = Gaussian(Discrete(len(means)), NUMBER)
    with torch.no_grad():
        made.mean.copy_(torch.tensor(means).unsqueeze(-1))
        made.log_scale.copy_((torch.tensor(scales).unsqueeze(-1) - 1e-3).log())
    return made


def evaluate(task, perception, action, world=None, betas=(2.0, 3.0)):
    """Over the known states; or over sampled worlds, whose states are not known."""
    task, world = (Hidden(task), world) if world else (task, task.states())
    return evaluate_chain(
        Chain(task, perception, action, default_marginals(task, NUMBER), *betas), world
    )


class Hidden(Task):
    """Another task whose states nobody knows."""

    def __init__(self, task):
        self.task = task
        self.observation_space, self.action_space = task.observation_space, task.action_space

    def sample(self, count, generator):
        return self.task.sample(count, generator)

    def utility(self, state, action):
        return self.task.utility(state, action)


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


@pytest.mark.parametrize(
    ("perception", "action"),
    [(MLP, Multinomial), (MLP, Table), (MLP, MLP)],
)
def test_exact_for_finite_tasks(perception, action):
    task = PredatorPrey()
    chain = (
        channel(perception, task.observation_space, Discrete(5)),
        channel(action, Discrete(5), task.action_space, seed=1),
    )
    found = evaluate(task, *chain)
    tables = [
        probabilities(part(given)).detach().double()
        for part, given in zip(chain, (task.observations, torch.arange(5)), strict=True)
    ]
    expected = table_objective(task.prior, *tables, task.utilities, 2.0, 3.0).item()
    assert found.exact
    for name in NAMES:  # float32 channels
        assert getattr(found.objective, name) == pytest.approx(getattr(expected, name), abs=1e-6)
    torch.testing.assert_close(found.percept_given_state, tables[0], rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(found.action_given_percept, tables[1], rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(
        found.action_given_state, tables[0] @ tables[1], rtol=1e-6, atol=1e-7
    )
    assert found.action_given_state.dtype == torch.float64


def test_exact_evaluation_draws_nothing():
    task = PredatorPrey()
    chain = (MLP(task.observation_space, Discrete(3)), Table(Discrete(3), task.action_space))
    before = torch.get_rng_state()
    assert evaluate(task, *chain) != evaluate(task, *chain, betas=(1.0, 1.0))
    assert torch.equal(before, torch.get_rng_state())


def test_zero_prior_mass():
    task = TableTask(torch.eye(3), prior=[0.5, 0.5, 0.0], observations="index")
    smaller = TableTask(torch.eye(3)[:2], observations="index")
    perception = channel(Table, Discrete(3), Discrete(4))
    action = channel(Table, Discrete(4), Discrete(3))
    head = Table(Discrete(2), Discrete(4))
    with torch.no_grad():
        head.logits.copy_(perception.logits[:2])
    found, expected = evaluate(task, perception, action), evaluate(smaller, head, action)
    for name in NAMES:
        assert getattr(found.objective, name) == pytest.approx(
            getattr(expected.objective, name), abs=1e-7
        )


def multinomial_batches(prior, size):
    """All batches of a size up to order, with their probabilities."""
    for counts in itertools.product(range(size + 1), repeat=len(prior)):
        if sum(counts) == size:
            ways = math.factorial(size) / math.prod(map(math.factorial, counts))
            probability = ways * math.prod(p**n for p, n in zip(prior, counts, strict=True))
            states = torch.repeat_interleave(torch.arange(len(prior)), torch.tensor(counts))
            yield states, probability


@pytest.mark.parametrize("size", [8, 12])
def test_first_order_bias_of_sampled_evaluation_is_corrected(size):
    # The expectation over batches is summed, not sampled: the standard error is zero.
    prior = [0.5, 0.3, 0.2]
    task = TableTask(torch.eye(3), prior=prior, observations="index")
    perception = channel(Table, Discrete(3), Discrete(4))
    action = channel(Table, Discrete(4), Discrete(3), seed=1)
    truth = evaluate(task, perception, action).objective
    truths = [getattr(truth, name) for name in NAMES[2:]]
    corrected, uncorrected, total = torch.zeros(3), torch.zeros(3), 0.0
    for states, probability in multinomial_batches(prior, size):
        found = evaluate(task, perception, action, World(states, states))
        assert not found.exact
        information = torch.tensor([getattr(found.objective, name) for name in SAMPLED[2:]])
        first = one_stratum(size).shortfall(found.percept_given_state)[0].item()
        both = one_stratum(size).shortfall(found.action_given_state)[0].item()
        corrected += probability * information
        uncorrected += probability * (information - torch.tensor([first, both, both]))
        total += probability
    assert total == pytest.approx(1)
    left = (corrected - torch.tensor(truths)).abs()
    right = (uncorrected - torch.tensor(truths)).abs()
    # What is left is of second order, 1/N smaller.
    assert (left < 3 * right / size).all(), (left, right)
    assert (right > 5e-4).all()


def test_sampled_objective_is_consistent_with_its_terms():
    task = PredatorPrey()
    perception = channel(MLP, task.observation_space, Discrete(4))
    action = channel(Multinomial, Discrete(4), task.action_space)
    world = task.sample(50, torch.Generator().manual_seed(0))
    terms = evaluate(task, perception, action, world).objective
    expected = (
        terms.expected_utility - terms.perception_information / 2 - terms.action_information / 3
    )
    assert terms.objective == pytest.approx(expected, abs=1e-12)


def one_stratum(count):
    return StratifiedSample(torch.zeros(count, dtype=torch.long), torch.ones(1).double())


def test_shortfall_by_hand():
    rows = torch.tensor([[1.0, 0, 0], [0.5, 0.5, 0]]).double()
    # s² = 1/8 twice, means 3/4 and 1/4, N = 2; the outcome without mass adds nothing.
    expected = 0.5 * (0.125 / 0.75 + 0.125 / 0.25) / 2
    overall, within = one_stratum(2).shortfall(rows)
    assert overall.item() == pytest.approx(expected)
    assert within.item() == pytest.approx(expected)


def test_strata_by_hand():
    # The last group is absent: its mass goes to the others, 0.6 and 0.4.
    rows = torch.tensor([[1.0, 0], [0, 1], [0.5, 0.5]]).double()
    sample = StratifiedSample(torch.tensor([0, 0, 1]), torch.tensor([0.3, 0.2, 0.5]).double())
    assert sample.mass.tolist() == pytest.approx([0.6, 0.4, 0])
    assert sample.weights.tolist() == pytest.approx([0.3, 0.3, 0.4])
    assert sample.means(rows).tolist() == [[0.5, 0.5], [0.5, 0.5], [0, 0]]
    # s² = ½ in the first group alone, of two signals: the variance of its mean is ¼.
    overall, within = sample.shortfall(rows)
    assert overall.item() == pytest.approx(0.5 * 2 * 0.36 * 0.25 / 0.5)
    assert within.item() == pytest.approx(0.5 * 0.6 * 2 * 0.25 / 0.5)


class Blurred(FiniteTask):
    """State ω shows signal ω with probability 0.8, else any of the four."""

    def __init__(self, prior):
        super().__init__([[1.0, 0], [0, 2.0], [0.5, 1]], prior, observations=Discrete(4))

    def observe(self, state, generator):
        noise = torch.randint(4, state.shape, generator=generator)
        kept = torch.rand(state.shape, generator=generator) < 0.8
        return torch.where(kept, state, noise)


@pytest.mark.parametrize("each", [8, 64])
def test_noisy_sensor(each):
    # J over signals as if signals were states, and I(Ω;·) from the composed channels. Means over
    # 400 evaluations; six standard errors in six comparisons: failure probability 1e-8.
    prior = torch.tensor([0.5, 0.3, 0.2]).double()
    task = Blurred(prior)
    perception = channel(Table, Discrete(4), Discrete(3), spread=2.0)
    action = channel(Multinomial, Discrete(3), Discrete(2), start=[[1.0, -2.0, 0.5]])
    signal_given = 0.8 * torch.eye(4)[:3].double() + 0.05
    tables = [
        probabilities(perception(torch.arange(4))).detach().double(),
        probabilities(action(torch.arange(3))).detach().double(),
    ]
    composed = signal_given @ tables[0]
    over_states = table_objective(prior, composed, tables[1], task.utilities, 2.0, 3.0).item()
    signal = prior @ signal_given
    posterior = (prior.unsqueeze(-1) * signal_given / signal).T
    over_signals = table_objective(signal, *tables, posterior @ task.utilities, 2.0, 3.0).item()
    expected = {
        "objective": over_signals.objective,
        "expected_utility": over_states.expected_utility,
        "perception_information": over_signals.perception_information,
        "action_information": over_states.action_information,
        "end_to_end_information": over_states.end_to_end_information,
        "state_information": over_states.perception_information,
    }
    assert expected["perception_information"] > 1.2 * expected["state_information"]
    runs = []
    for seed in range(400):
        state = torch.arange(3).repeat_interleave(each)
        world = World(state, task.observe(state, torch.Generator().manual_seed(seed)))
        marginals = default_marginals(task, Discrete(3))
        found = evaluate_chain(Chain(task, perception, action, marginals, 2.0, 3.0), world)
        assert not found.exact and found.percept_given_state.shape == (3, 3)
        runs.append([getattr(found.objective, name) for name in expected])
    runs = torch.tensor(runs, dtype=torch.double)
    left = runs.mean(0) - torch.tensor(list(expected.values()), dtype=torch.double)
    # Second order in 1/n is left.
    allowed = 6 * runs.std(0) / math.sqrt(len(runs)) + 0.5 / each**2
    assert (left.abs() < allowed).all(), (left, allowed)


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
