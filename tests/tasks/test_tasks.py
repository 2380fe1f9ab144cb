"""Tasks: what they draw, what they pay, what they refuse."""

import math

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra.tasks import FiniteTask, PredatorPrey, TableTask, TargetTask
from bra.tasks.finite import utility_table
from bra.tasks.observations import grey_levels, has_grey_levels

ANIMALS = [2, 3, 4, 6, 7, 8, 10, 11, 12]
HUNTING = """
    2    3.5  2.4  2.4  2.3  2.3  2.3  2.3   3.0   0.5
    3    2.4  3.5  2.4  2.3  2.3  2.3  2.3   3.0   0.5
    4    2.4  2.4  3.5  2.3  2.3  2.3  2.3   3.0   0.5
    6    1.5  1.5  1.5  2.3  1.84 1.84 2.3   1.5   0.5
    7    1.5  1.5  1.5  1.84 2.3  1.84 2.3   1.5   0.5
    8    1.5  1.5  1.5  1.84 1.84 2.3  2.3   1.5   0.5
    10   0    0    0    0    0    0    0     0     5.0
    11   0    0    0    0    0    0    0     0     5.0
    12   0    0    0    0    0    0    0     0     5.0
"""
MATING = "2 1 1\n3 1 1\n4 1 1\n6 2.5 1\n7 0.5 4\n8 4 0.5\n10 0 5\n11 0 5\n12 0 5"
HUNTING_ACTIONS = ("su2", "su3", "su4", "am6", "am7", "am8", "ambush", "sneak", "flee")
TABLE = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.5]]


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize(
    ("variant", "text", "actions"),
    [("hunting", HUNTING, HUNTING_ACTIONS), ("mating", MATING, ("display", "flee"))],
)
def test_predator_prey_pays_what_was_published(variant, text, actions):
    rows = [[float(cell) for cell in line.split()] for line in text.strip().splitlines()]
    task = PredatorPrey(variant)
    assert [row[0] for row in rows] == ANIMALS
    assert torch.equal(task.utilities, torch.tensor([row[1:] for row in rows], dtype=torch.float64))
    assert task.action_names == actions
    assert task.action_space == Discrete(len(actions))
    assert task.state_names == tuple(f"size {size}" for size in ANIMALS)
    assert torch.equal(task.prior, torch.full((9,), 1 / 9, dtype=torch.float64))


def test_predator_prey_hunts_by_binary_sensor_unless_told_otherwise():
    task, same = PredatorPrey(), PredatorPrey("hunting", "binary")
    assert torch.equal(task.utilities, same.utilities)
    assert torch.equal(task.observations, same.observations)


BITS = [[int(bit) for bit in f"{size:04b}"] for size in ANIMALS]


@pytest.mark.parametrize(
    ("code", "space", "signals"),
    [
        ("binary", Box(0, 1, (4,), np.float32), torch.tensor(BITS).float()),
        ("bipolar", Box(-1, 1, (4,), np.float32), 2.0 * torch.tensor(BITS) - 1),
        ("onehot", Box(0, 1, (9,), np.float32), torch.eye(9)),
        ("index", Discrete(9), torch.arange(9)),
    ],
)
def test_sensor_codes(code, space, signals):
    task = PredatorPrey(observations=code)
    assert task.observation_space == space
    assert task.observations.dtype == signals.dtype
    assert torch.equal(task.observations, signals)
    assert all(task.observation_space.contains(signal.numpy()) for signal in signals)


@pytest.mark.parametrize(
    ("states", "signals"),
    [(1, [[0]]), (2, [[0], [1]]), (5, [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0]])],
)
def test_binary_code_of_the_index_is_as_short_as_possible(states, signals):
    task = TableTask([[0.0, 1.0]] * states, observations="binary")
    assert torch.equal(task.observations, torch.tensor(signals).float())


def test_states_follow_the_prior():
    # Chi-square with 3 degrees of freedom on 50 000 draws; above 40 with probability 1e-8.
    prior = torch.tensor([0.5, 0.3, 0.15, 0.05])
    task = TableTask(torch.eye(4), prior=prior)
    world = task.sample(50_000, generator())
    counts = torch.bincount(world.state, minlength=4)
    assert ((counts - 50_000 * prior) ** 2 / (50_000 * prior)).sum() < 40
    assert torch.equal(world.observation, task.observations[world.state])


def test_states_without_mass_do_not_occur():
    task = TableTask(torch.eye(3), prior=[0.5, 0.0, 0.5])
    assert set(task.sample(1000, generator()).state.tolist()) == {0, 2}


def test_the_sample_is_a_function_of_the_generator():
    task = PredatorPrey()
    before = torch.get_rng_state()
    one = task.sample(100, generator(1))
    torch.manual_seed(5)
    same, other = task.sample(100, generator(1)), task.sample(100, generator(2))
    torch.set_rng_state(before)
    assert torch.equal(one.state, same.state)
    assert torch.equal(one.observation, same.observation)
    # Equal by chance with probability 9⁻¹⁰⁰.
    assert not torch.equal(one.state, other.state)


def test_sampling_leaves_the_default_generator_alone():
    before = torch.get_rng_state()
    PredatorPrey().sample(10, generator())
    assert torch.equal(before, torch.get_rng_state())


def test_states_in_order():
    task = PredatorPrey()
    world = task.states()
    assert torch.equal(world.state, torch.arange(9))
    assert torch.equal(world.observation, task.observations)


@pytest.mark.parametrize(("state", "action"), [((), ()), ((5,), (5,)), ((4, 1), (3,)), ((3,), ())])
def test_utility_is_the_table_broadcast(state, action):
    task = PredatorPrey()
    states = torch.randint(9, state, generator=generator())
    actions = torch.randint(9, action, generator=generator(1))
    utility = task.utility(states, actions)
    expected = task.utilities.numpy()[states.numpy(), actions.numpy()]
    assert utility.shape == torch.broadcast_shapes(state, action)
    assert utility.dtype == torch.float64
    np.testing.assert_array_equal(utility.numpy(), expected)


@pytest.mark.parametrize(
    "utilities",
    [TABLE, tuple(map(tuple, TABLE)), np.array(TABLE), torch.tensor(TABLE), np.float32(TABLE)],
)
def test_table_from_arrays(utilities):
    task = TableTask(utilities)
    assert torch.equal(task.utilities, torch.tensor(TABLE, dtype=torch.float64))
    assert task.state_names == ("s0", "s1")
    assert task.action_names == ("a0", "a1", "a2")
    assert torch.equal(task.observations, torch.eye(2))
    assert isinstance(task, FiniteTask)


def test_a_task_keeps_its_own_table():
    utilities, prior = torch.tensor(TABLE).double(), torch.tensor([0.5, 0.5]).double()
    task = TableTask(utilities, prior=prior)
    utilities.zero_()
    prior.zero_()
    assert task.utilities[1, 2] == 6.5
    assert task.prior.sum() == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"utilities": [[1.0, 2.0], [3.0]]}, "rows of equal length"),
        ({"utilities": [["one", "two"]]}, "table of numbers"),
        ({"utilities": []}, r"a row per state, got shape \(0,\)"),
        ({"utilities": [[]]}, r"a row per state, got shape \(1, 0\)"),
        ({"utilities": [1.0, 2.0]}, r"a row per state, got shape \(2,\)"),
        ({"utilities": [[0.0, math.nan]]}, "forbidden action, got nan in row 0, column 1"),
        (
            {"utilities": [[0.0, 1.0], [math.inf, 1.0]]},
            "action, got inf in row 1, column 0",
        ),
        ({"prior": [1.5, -0.5]}, r"finite and not negative, got \[1.5, -0.5\]"),
        ({"prior": [0.5, math.nan]}, "finite and not negative"),
        ({"prior": [0.5, 0.4]}, r"sum to 1, got 0.9; divide"),
        ({"prior": [0.5, 0.25, 0.25]}, r"each of 2 states, got shape \(3,\)"),
        ({"prior": [[0.5, 0.5]]}, r"each of 2 states, got shape \(1, 2\)"),
        ({"observations": "gray"}, "onehot, index, binary, bipolar or an array, got 'gray'"),
        ({"observations": [[1.0]]}, r"shape \(2, …\), one signal per state, got shape \(1, 1\)"),
        ({"observations": [1.0, 2.0]}, r"one signal per state, got shape \(2,\)"),
        ({"observations": [[1.0], [math.inf]]}, "observations must be finite"),
        ({"state_names": ["mouse"]}, "expected 2 names"),
        ({"action_names": ["a", "b"]}, "expected 3 names"),
    ],
)
def test_bad_tables_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        TableTask(**{"utilities": TABLE} | arguments)


@pytest.mark.parametrize("numbers", [(1, 2), (1, 2, 3, 4), (1, -2, 3)])
def test_binary_codes_need_a_number_per_state(numbers):
    with pytest.raises(ValueError, match="number"):
        FiniteTask(torch.eye(3), observations="binary", state_numbers=numbers)


def test_state_numbers_may_be_an_array():
    task = FiniteTask(torch.eye(3), observations="binary", state_numbers=np.array([1, 2, 3]))
    assert task.observations.tolist() == [[0, 1], [1, 0], [1, 1]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"variant": "huntin"}, "hunting or mating, got 'huntin'"),
        ({"observations": "grey"}, "onehot, index, binary, bipolar or an array, got 'grey'"),
    ],
)
def test_predator_prey_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        PredatorPrey(**arguments)


def test_a_prior_that_is_off_by_rounding_is_normalised():
    prior = torch.tensor([0.1] * 10, dtype=torch.float32)
    task = TableTask(torch.eye(10), prior=prior)
    assert task.prior.sum().item() == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("kind", [np.array, torch.tensor, list])
def test_observations_as_an_array(kind):
    signals = np.arange(8.0).reshape(2, 2, 2).tolist()
    task = TableTask(TABLE, observations=kind(signals))
    assert task.observation_space == Box(-np.inf, np.inf, (2, 2), np.float32)
    assert torch.equal(task.observations, torch.tensor(signals))
    world = task.sample(5, generator())
    assert world.observation.shape == (5, 2, 2)


def test_target_task_pays_squared_distance():
    task = TargetTask([[0.0, 1.0], [2.0, -1.0]], prior=[0.25, 0.75], observations="index")
    assert task.action_space == Box(-np.inf, np.inf, (2,), np.float32)
    assert task.observation_space == Discrete(2)
    utility = task.utility(torch.tensor([0, 1]), torch.tensor([[3.0, 5.0], [2.0, 0.0]]))
    assert utility.tolist() == [-25.0, -1.0]
    # Broadcast: every state, three actions each.
    actions = torch.randn(3, 1, 2, generator=generator())
    pairs = task.utility(torch.arange(2), actions)
    assert pairs.shape == (3, 2)
    expected = -((task.targets.float() - actions) ** 2).sum(-1)
    torch.testing.assert_close(pairs, expected)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([1.0, 2.0], r"targets must be a table with a row per state, got shape \(2,\)"),
        ([[1.0], [math.nan]], "targets must be finite, got nan in row 1"),
    ],
)
def test_target_task_refuses(targets, message):
    with pytest.raises(ValueError, match=message):
        TargetTask(targets)


def test_grey_levels_go_from_black_to_white():
    space = Box(-1.0, 3.0, shape=(1, 2, 2))
    assert has_grey_levels(space)
    assert grey_levels(space, torch.tensor([-1.0, 1.0, 3.0])).tolist() == [0.0, 0.5, 1.0]
    assert not has_grey_levels(Box(np.array([0.0, 1.0]), np.array([2.0, 2.0])))
    assert not has_grey_levels(Box(-np.inf, np.inf, shape=(1, 2, 2)))
    assert not has_grey_levels(Box(1.0, 1.0, shape=(2,)))


def test_a_forbidden_action_pays_a_penalty_that_is_finite():
    task = TableTask([[1.0, -math.inf], [3.0, 0.0]])
    assert task.utilities.tolist() == [[1.0, -math.inf], [3.0, 0.0]]
    assert task.payoffs.tolist() == [[1.0, -90.0], [3.0, 0.0]]
    assert task.utility(torch.tensor([0, 0]), torch.tensor([1, 0])).tolist() == [-90.0, 1.0]
    assert TableTask([[0.0, -math.inf], [-math.inf, 0.0]]).payoffs[0, 1] == -30.0
    assert torch.equal(TableTask([[1.0, 2.0]]).payoffs, TableTask([[1.0, 2.0]]).utilities)


class Doubled(FiniteTask):
    """Pays twice what its table says."""

    def utility(self, state, action):
        return 2 * super().utility(state, action)


def test_all_pairs_are_paid_what_the_task_pays():
    states, actions = torch.tensor([1, 0, 1]), torch.tensor([2, 0])
    picked = torch.tensor(TABLE, dtype=torch.double)[states][:, actions]
    assert torch.equal(utility_table(FiniteTask(TABLE), states, actions), picked)
    assert torch.equal(utility_table(Doubled(TABLE), states, actions), 2 * picked)
    target = TargetTask([[0.0, 1.0], [2.0, 3.0]])
    found = utility_table(target, torch.tensor([0, 1]), torch.tensor([[0.0, 0.0], [2.0, 3.0]]))
    assert found.tolist() == [[-1.0, -8.0], [-13.0, 0.0]]
