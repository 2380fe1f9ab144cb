"""The optimum that a noisy sensor allows, against numerical integration."""

import itertools
import math

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra import PredatorPrey, TableTask
from bra.blahut_arimoto import rate_distortion, serial
from bra.evaluation.references import solve_references
from bra.tasks import FiniteTask, TargetTask

PRIOR = [0.4, 0.3, 0.2, 0.1]
PRICES = [(8.0, 8.0), (20.0, 20.0)]
BETAS = torch.tensor([8.0, 20.0])


class Cue(FiniteTask):
    """State i is seen at i, with normal noise; further numbers are noise alone."""

    def __init__(self, sigma=0.7, numbers=1):
        super().__init__(np.eye(4), PRIOR, observations=Box(-np.inf, np.inf, (numbers,)))
        self.sigma = sigma

    def observe(self, state, generator):
        noise = torch.randn((len(state), *self.observation_space.shape), generator=generator)
        noise[:, 0] = self.sigma * noise[:, 0] + state
        return noise


def integrated(sigma, intervals=400):
    """J of the cue at PRICES by the probabilities of narrow intervals."""
    edges = torch.linspace(-6 * sigma, 3 + 6 * sigma, intervals + 1, dtype=torch.double)
    places = torch.arange(4, dtype=torch.double)[:, None]
    given = torch.special.ndtr((edges - places) / sigma).diff(dim=1)
    joint = torch.tensor(PRIOR).double()[:, None] * given
    found = serial((joint / joint.sum(0)).T, joint.sum(0) / joint.sum(), 4, BETAS, BETAS, budget=32)
    return found.objective.tolist()


@pytest.mark.parametrize("sigma", [pytest.param(0.3, marks=pytest.mark.slow), 0.7])
def test_a_noisy_cue(sigma):
    found = solve_references(Cue(sigma), Discrete(4), PRICES, seed=0)
    assert [*found] == PRICES
    clear = serial(np.eye(4), PRIOR, 4, BETAS, BETAS)
    for reference, expected, best in zip(
        found.values(), integrated(sigma), clear.objective.tolist(), strict=True
    ):
        assert abs(reference.objective - expected) < reference.error < 0.005
        assert abs(reference.objective - expected) < 0.002
        assert reference.objective_without_noise == pytest.approx(best, abs=1e-9)
        assert expected <= reference.tight_bound <= reference.upper_bound <= 1
        assert reference.optimum.percept_given_state.shape == (4, 4)
        assert reference.note == ""
    # What 0.7 hides: 0.680 and 0.872 without noise, 0.407 and 0.537 with it.
    if sigma == 0.7:
        assert clear.objective.tolist() == pytest.approx([0.680, 0.872], abs=5e-4)
        assert [r.objective for r in found.values()] == pytest.approx([0.407, 0.537], abs=1e-3)


@pytest.mark.parametrize(
    ("draws", "most"), [(2**18, 0.02), pytest.param(2**20, 0.01, marks=pytest.mark.slow)]
)
def test_signals_of_two_numbers(monkeypatch, draws, most):
    monkeypatch.setattr("bra.tasks.signals.DRAWS", draws)
    (reference,) = solve_references(Cue(numbers=2), Discrete(4), PRICES[:1], seed=0).values()
    assert abs(reference.objective - integrated(0.7)[0]) < reference.error < most


FLIP = [[0.9, 0.1, 0.0], [0.1, 0.7, 0.2], [0.0, 0.2, 0.8]]
WORTH = [[1.0, 0.0, 0.2], [0.0, 0.8, 0.1], [0.3, 0.0, 0.9]]


def test_known_signals_are_exact():
    task = TableTask(WORTH, [0.5, 0.3, 0.2], "index", signal_given_state=FLIP)
    (reference,) = solve_references(task, Discrete(3), [(20.0, 30.0)], seed=0).values()
    joint = torch.tensor([[0.5], [0.3], [0.2]]).double() * torch.tensor(FLIP).double()
    mass = joint.sum(0)
    expected = serial((joint / mass).T @ torch.tensor(WORTH).double(), mass, 3, 20.0, 30.0)
    assert reference.error == 0
    assert reference.objective == pytest.approx(expected.objective, abs=1e-7)
    assert reference.upper_bound == pytest.approx(expected.upper_bound, abs=1e-7)
    # The chain from states to actions, by hand.
    optimum = reference.optimum
    percept = torch.tensor(FLIP).double() @ expected.percept_given_state
    torch.testing.assert_close(optimum.percept_given_state, percept, rtol=0, atol=1e-4)
    behaviour = percept @ expected.action_given_percept
    torch.testing.assert_close(optimum.action_given_state, behaviour, rtol=0, atol=1e-4)
    p = torch.tensor([0.5, 0.3, 0.2]).double()
    utility = (p[:, None] * behaviour * torch.tensor(WORTH)).sum().item()
    assert optimum.expected_utility == pytest.approx(utility, abs=1e-4)


class Slips(FiniteTask):
    """The same sensor, of which only draws are to be had."""

    def __init__(self, codes):
        space = Discrete(3) if codes is None else Box(0, 1, (len(codes[0]),))
        super().__init__(WORTH, [0.5, 0.3, 0.2], observations=space)
        self.codes = torch.arange(3) if codes is None else torch.tensor(codes)

    def observe(self, state, generator):
        return self.codes[
            torch.multinomial(torch.tensor(FLIP)[state], 1, generator=generator)[:, 0]
        ]


@pytest.mark.parametrize("codes", [None, list(itertools.product([0.0, 1.0], repeat=6))[:3]])
def test_signals_that_come_again_are_counted(codes):
    exact = TableTask(WORTH, [0.5, 0.3, 0.2], signal_given_state=FLIP)
    (expected,) = solve_references(exact, Discrete(3), [(20.0, 30.0)], seed=0).values()
    (found,) = solve_references(Slips(codes), Discrete(3), [(20.0, 30.0)], seed=0).values()
    assert abs(found.objective - expected.objective) < found.error < 0.004


def test_a_sensor_that_hides_nothing_leaves_the_optimum():
    codes = [[0.2, 0.8, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0.5, 0.3, 0.2]]
    task = TableTask(WORTH, signal_given_state=codes)
    (found,) = solve_references(task, Discrete(3), [(20.0, 30.0)], seed=0).values()
    assert found.objective == pytest.approx(found.objective_without_noise, abs=1e-6)


def test_what_cannot_be_known_is_said():
    box = Box(-math.inf, math.inf, (2,))
    (images,) = solve_references(Cue(numbers=64), Discrete(4), PRICES[:1], seed=0).values()
    assert images.optimum is None
    assert images.objective_without_noise == pytest.approx(0.680, abs=5e-4)
    assert images.upper_bound == pytest.approx(images.without_noise.upper_bound)
    assert images.note == (
        "no optimum: a signal is 64 numbers that hardly ever come again, which leaves "
        "p(signal|state) unknown; give Cue a signal_given_state"
    )
    task = PredatorPrey()
    (found,) = solve_references(task, box, [(8.0, 10.0)], seed=0).values()
    bound = rate_distortion(task.utilities, task.prior, 80 / 18).upper_bound
    assert found.upper_bound == pytest.approx(bound, abs=1e-12)
    assert found.note.startswith("no optimum: percepts Box(-inf, inf, (2,), float32)")
    targets = TargetTask([[0.0] * 4, [1.0] * 4])
    (found,) = solve_references(targets, Discrete(2), PRICES[:1], seed=0).values()
    assert found.note == "no optimum: TargetTask has no table of utilities, and no grid"
    assert found.upper_bound is None


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[1.0, 0.0]], "signal_given_state must have one row for each of 3 states, got 1"),
        ([[0.5, 0.6]] * 3, "rows of probabilities that sum to 1, got"),
        ([[-0.5, 1.5]] * 3, "rows of probabilities that sum to 1, got"),
    ],
)
def test_tables_of_signals_are_checked(rows, message):
    with pytest.raises(ValueError, match=message):
        TableTask(WORTH, signal_given_state=rows)


def test_signals_are_drawn_as_their_table_says():
    task = TableTask(WORTH, [0.5, 0.3, 0.2], "onehot", signal_given_state=FLIP)
    assert not task.noiseless and task.observations is None
    world = task.sample(20_000, torch.Generator().manual_seed(0))
    assert world.observation.shape == (20_000, 3)
    for state, row in enumerate(FLIP):
        seen = world.observation[world.state == state].mean(0)
        # 4000 draws at least: six standard errors, failure probability 2e-9 each.
        torch.testing.assert_close(seen, torch.tensor(row), rtol=0, atol=6 * 0.5 / 4000**0.5)
