"""Recipes: plain data that rebuild tasks, factories, rules and spaces, and nothing else."""

import io
import math
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from torch import nn
from torch.optim import SGD, Adam
from torch.optim.lr_scheduler import ExponentialLR, StepLR

from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.checkpoints.recipes import (
    from_recipe,
    same_recipe,
    to_recipe,
)
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.tasks import FiniteTask, PredatorPrey, TableTask, TargetTask
from bra.update_rules import ExactGradient, ScoreFunction

NUMBERS = Box(-1, 1, (2,), np.float32)


def instantiate(cls, *args, **kwargs):
    """What jsonargparse binds a class to: partial(instantiate, Class, **arguments)."""
    return cls(*args, **kwargs)


def through_file(recipe):
    file = io.BytesIO()
    torch.save(recipe, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


def round_trip(value):
    """The value rebuilt from its recipe in a file; the recipe survives both ways."""
    recipe = to_recipe(value)
    loaded = through_file(recipe)
    assert same_recipe(loaded, recipe)
    rebuilt = from_recipe(loaded)
    assert same_recipe(to_recipe(rebuilt), recipe)
    return rebuilt


@pytest.mark.parametrize(
    "value",
    [None, True, 3, -2.5, math.inf, "text", [], [1, [2.0, "three"]], {}, {"a": {"b": [None]}}],
)
def test_plain_data_is_its_own_recipe(value):
    assert to_recipe(value) == value
    assert round_trip(value) == value


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ((1, (2, 3)), [1, [2, 3]]),
        (np.float64(0.5), 0.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        ({1: "one"}, {"1": "one"}),
    ],
)
def test_relatives_of_plain_data_become_plain(value, expected):
    recipe = to_recipe(value)
    assert recipe == expected
    assert type(recipe) is type(expected)


def test_paths_become_strings(tmp_path):
    assert to_recipe(tmp_path) == str(tmp_path)


@pytest.mark.parametrize("kind", [torch.tensor, np.array])
def test_tensors_keep_values_and_type(kind):
    recipe = round_trip({"values": kind([[1.0, 2.0]])})
    assert torch.equal(recipe["values"], torch.as_tensor(kind([[1.0, 2.0]])))
    assert recipe["values"].dtype == torch.as_tensor(kind([[1.0, 2.0]])).dtype


def test_recipes_do_not_share_memory_with_what_they_describe():
    tensor = torch.zeros(2, requires_grad=True)
    recipe = to_recipe(tensor)
    with torch.no_grad():
        tensor.add_(1)
    assert torch.equal(recipe, torch.zeros(2))
    assert not recipe.requires_grad


@pytest.mark.parametrize(
    "space",
    [
        Discrete(7),
        NUMBERS,
        Box(-np.inf, np.inf, (), np.float32),
        Box(0, 255, (1, 4, 3), np.uint8),
        Box(np.array([0.0, -1.0]), np.array([1.0, np.inf]), dtype=np.float64),
    ],
)
def test_spaces_round_trip(space):
    assert round_trip(space) == space


class Fixed(TableTask):
    """A table without arguments."""

    def __init__(self):
        super().__init__([[1.0, 0.0], [0.0, 2.0]], [0.25, 0.75])


class Scaled(TableTask):
    """A table made from another one."""

    def __init__(self, utilities, factor=3.0):
        super().__init__(factor * np.asarray(utilities))


@pytest.mark.parametrize(
    "task",
    [
        PredatorPrey(),
        Fixed(),
        Scaled([[0.0, 1.0], [2.0, 3.0]]),
        PredatorPrey("mating", observations="bipolar"),
        TableTask([[0.0, 1.0], [2.0, 3.0]]),
        TableTask(np.eye(2), prior=np.array([0.25, 0.75]), action_names=("go", "stay")),
        TableTask(torch.eye(2), observations=torch.arange(8.0).reshape(2, 1, 2, 2)),
        FiniteTask(torch.eye(3), observations="binary", state_numbers=(3, 5, 8)),
        TargetTask([[0.0, 1.0], [2.0, 3.0]], prior=[0.5, 0.5], observations="index"),
    ],
    ids=lambda task: type(task).__name__,
)
def test_tasks_round_trip(task):
    rebuilt = round_trip(task)
    assert type(rebuilt) is type(task)
    assert rebuilt.observation_space == task.observation_space
    assert rebuilt.action_space == task.action_space
    assert rebuilt.state_names == task.state_names
    assert torch.equal(rebuilt.prior, task.prior)
    worlds = [each.sample(20, torch.Generator().manual_seed(0)) for each in (task, rebuilt)]
    assert all(map(torch.equal, *worlds))
    space = task.action_space
    action = torch.tensor(0) if isinstance(space, Discrete) else torch.ones(space.shape)
    states = torch.arange(len(task.prior))
    assert torch.equal(task.utility(states, action), rebuilt.utility(states, action))


def test_a_table_task_outlives_its_file(tmp_path):
    path = tmp_path / "hunt.csv"
    path.write_text("state,stay,flee\nmouse,3.5,0.5\nlion,0,5\n")
    task = TableTask(path)
    recipe = through_file(to_recipe(task))
    path.unlink()
    rebuilt = from_recipe(recipe)
    assert torch.equal(rebuilt.utilities, task.utilities)
    assert (rebuilt.state_names, rebuilt.action_names) == (task.state_names, task.action_names)


@pytest.mark.parametrize(
    ("rule", "attributes"),
    [
        (ScoreFunction(3, baseline="leave-one-out"), {"samples": 3, "baseline": "leave-one-out"}),
        (ScoreFunction(), {"samples": 1, "baseline": "none"}),
        (ExactGradient(), {}),
        (ExactMarginals(), {}),
        (BatchMarginals(), {}),
        (RunningMarginals(decay=0.5), {"decay": 0.5}),
    ],
)
def test_rules_and_marginals_round_trip(rule, attributes):
    rebuilt = round_trip(rule)
    assert type(rebuilt) is type(rule)
    assert {name: getattr(rebuilt, name) for name in attributes} == attributes


FACTORIES = {
    "class": (Table, (Discrete(3), Discrete(2))),
    "class with defaults": (MLP, (NUMBERS, Discrete(2))),
    "partial": (partial(Gaussian, scale=0.5), (Discrete(3), NUMBERS)),
    "partial with a class": (
        partial(MLP, hidden=(4, 5), activation=nn.ReLU, bias=False),
        (NUMBERS, Discrete(2)),
    ),
    "partial with a tensor": (
        partial(Multinomial, reference=1, start=torch.ones(1, 2)),
        (Discrete(2), Discrete(2)),
    ),
    "jsonargparse": (partial(instantiate, MLP, hidden=[6]), (NUMBERS, Discrete(2))),
    "jsonargparse, bare": (
        partial(instantiate, CNN),
        (Box(0, 1, (1, 3, 3), np.float32), Discrete(2)),
    ),
    "partial in partial": (
        partial(MLP, activation=partial(nn.LeakyReLU, negative_slope=0.3)),
        (NUMBERS, Discrete(2)),
    ),
}


@pytest.mark.parametrize("name", FACTORIES)
def test_channel_factories_round_trip(name):
    factory, spaces = FACTORIES[name]
    rebuilt = round_trip(factory)
    torch.manual_seed(0)
    one = factory(*spaces)
    torch.manual_seed(0)
    other = rebuilt(*spaces)
    assert repr(one) == repr(other)
    states = one.state_dict(), other.state_dict()
    assert states[0].keys() == states[1].keys()
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


@pytest.mark.parametrize(
    "factory",
    [
        Adam,
        partial(SGD, lr=0.006, momentum=0.9),
        partial(SGD, lr=np.geomspace(0.001, 1, 4)[1]),  # a learning rate from a sweep
        partial(instantiate, Adam, lr=0.5, betas=(0.8, 0.99)),
    ],
)
def test_optimizer_factories_round_trip(factory):
    rebuilt = round_trip(factory)
    parameters = [nn.Parameter(torch.zeros(2))]
    one, other = factory(parameters), rebuilt(parameters)
    assert type(one) is type(other)
    for name, value in one.defaults.items():
        found = other.defaults[name]
        assert (tuple(found) if isinstance(value, tuple) else found) == value


@pytest.mark.parametrize(
    "factory", [partial(ExponentialLR, gamma=0.9), partial(StepLR, step_size=3)]
)
def test_scheduler_factories_round_trip(factory):
    rebuilt = round_trip(factory)
    optimizer = SGD([nn.Parameter(torch.zeros(1))], lr=1.0)
    one, other = factory(optimizer), rebuilt(optimizer)
    assert type(one) is type(other)
    assert (one.gamma, getattr(one, "step_size", 0)) == (
        other.gamma,
        getattr(other, "step_size", 0),
    )


def test_equal_factories_have_equal_recipes():
    spelt_out = partial(MLP, hidden=[20], activation=nn.Tanh, bias=True)
    recipes = [to_recipe(each) for each in (MLP, spelt_out, partial(instantiate, MLP))]
    assert same_recipe(recipes[0], recipes[1])
    assert same_recipe(recipes[0], recipes[2])
    positional, named = ScoreFunction(2, "running"), ScoreFunction(baseline="running", samples=2)
    assert same_recipe(to_recipe(positional), to_recipe(named))
