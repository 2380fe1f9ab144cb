"""J of given channels: exact where possible, close to the truth where it is estimated."""

import itertools
import math

import pytest
import torch
from evaluated import NAMES, channel, evaluate
from gymnasium.spaces import Discrete

from bra.chain import Chain
from bra.channels import MLP, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.evaluation import evaluate as evaluate_chain
from bra.evaluation.shortfall import StratifiedSample
from bra.marginals import default_marginals
from bra.objective import table_objective
from bra.tasks import FiniteTask, PredatorPrey, TableTask, World

SAMPLED = (*NAMES[:-1], "signal_action_information")
"""The same over sampled worlds, where a signal has one state."""


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


@pytest.mark.parametrize("each", [8, pytest.param(64, marks=pytest.mark.slow)])
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
