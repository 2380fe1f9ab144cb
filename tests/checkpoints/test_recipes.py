"""Recipes: plain data that rebuild tasks, factories, rules and spaces, and nothing else."""

import importlib
import io
import math
import sys
from collections import OrderedDict
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict, Discrete
from torch import nn
from torch.optim import SGD, Adam
from torch.optim.lr_scheduler import ExponentialLR, StepLR

from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.checkpoints.recipes import (
    Rebuildable,
    describe_recipe,
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


class WithExtras(Rebuildable):
    def __init__(self, first, *, scale=1.0, **extras):
        self.values = (first, scale, extras)


class Loose(Rebuildable):
    def __init__(self, *parts):
        self.parts = parts


class Stray:
    pass


def function(condition_space, outcome_space):
    return Table(condition_space, outcome_space)


def test_keyword_extras_are_remembered():
    value = WithExtras(1, depth=3)
    assert value.init_arguments() == {"first": 1, "scale": 1.0, "depth": 3}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (lambda c, o: Table(c, o), "lambda.* cannot be written into a checkpoint"),
        (function, "function.* cannot be written into a checkpoint"),
        (partial(function), "must be a functools.partial of one class"),
        (Stray, "Stray cannot be rebuilt from a checkpoint"),
        (Stray(), "cannot be written into a checkpoint"),
        (partial(Stray), "Stray cannot be rebuilt"),
        (partial(MLP, activation=lambda: nn.ReLU()), "lambda.* cannot be written"),
        ([1, {"deep": Stray()}], "cannot be written into a checkpoint"),
        (Loose(1, 2), r"arguments \(1, 2\) need names"),
        (nn.Linear(2, 2), "Linear.* cannot be written into a checkpoint"),
        (Dict({"a": Discrete(2)}), "cannot be written into a checkpoint"),
    ],
)
def test_what_has_no_recipe_is_refused(value, message):
    with pytest.raises(TypeError, match=message):
        to_recipe(value)


@pytest.mark.parametrize(
    ("class_path", "message"),
    [
        ("os.system", "asks for os.system, which no agent is made of; refused"),
        ("builtins.eval", "no agent is made of; refused"),
        ("subprocess.Popen", "no agent is made of; refused"),
        ("pathlib.Path", "no agent is made of; refused"),
        ("bra.checkpoints.recipes.from_recipe", "no agent is made of; refused"),
        ("nowhere.Channel", r"needs nowhere.Channel, of a module .* trusted=\('nowhere',\)"),
        ("xmlrpc.server.Channel", r"of a module that is not loaded.* trusted=\('xmlrpc',\)"),
        ("brandy.Channel", "of a module that is not loaded"),
        ("bra.checkpoints.recipes.os.system", "which cannot be imported"),
        ("bra.checkpoints.recipes.os", "no agent is made of; refused"),
        ("bra.cli.main.sys.exit", "which cannot be imported"),
        ("bra..Channel", "which cannot be imported"),
        ("bra./tmp/evil.Channel", "which cannot be imported"),
        ("bra.__main__.main", "no agent is made of; refused"),
        ("torch.nn.modules.linear.Linear.forward", "of a module that is not loaded"),
        ("bra.channels.Nothing", "needs bra.channels.Nothing, which cannot be imported"),
        ("Table", "needs Table, which cannot be imported"),
        ("", "cannot be imported"),
    ],
)
@pytest.mark.parametrize("factory", [False, True])
def test_recipes_of_anything_else_are_refused(class_path, message, factory):
    recipe = {"class_path": class_path, "init_args": {}, "factory": factory}
    for smuggled in (recipe, {"task": [recipe]}):
        with pytest.raises(ValueError, match=message):
            from_recipe(smuggled)


def test_nothing_is_called_before_it_is_refused(tmp_path):
    target = tmp_path / "made"
    recipe = {"class_path": "os.mkdir", "init_args": {"path": str(target)}}
    inner = {"class_path": "bra.tasks.PredatorPrey", "init_args": {"variant": recipe}}
    with pytest.raises(ValueError, match="refused"):
        from_recipe(inner)
    assert not target.exists()


MODULE = """
from pathlib import Path
from bra.channels import Table
Path(__file__).with_name("trace").touch()
class Mine(Table):
    pass
"""


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """A folder of modules, which are forgotten again."""
    monkeypatch.syspath_prepend(tmp_path)
    before = {*sys.modules}
    yield tmp_path
    for name in {*sys.modules} - before:
        del sys.modules[name]


def test_modules_are_imported_only_when_they_are_trusted(modules):
    (modules / "my_channels_of_a_test.py").write_text(MODULE)
    recipe = {"class_path": "my_channels_of_a_test.Mine", "init_args": {}, "factory": True}
    for trusted in ((), ("my_channels",), ("my_channels_of_a_test.more",)):
        with pytest.raises(ValueError, match=r"import it first, or load with trusted=\('my_chan"):
            from_recipe(recipe, trusted)
    assert not (modules / "trace").exists()
    mine = from_recipe(recipe, ("my_channels_of_a_test",))
    assert (modules / "trace").exists()
    assert from_recipe(recipe) is mine  # it is loaded now
    with pytest.raises(ValueError, match=r"asks for my_channels_of_a_test.Path.*refused"):
        from_recipe(recipe | {"class_path": "my_channels_of_a_test.Path"})


def test_a_loaded_module_is_not_made_to_import(modules):
    (modules / "lazy_of_a_test.py").write_text(
        "def __getattr__(name):\n    import my_channels_of_a_test as module\n"
        "    return getattr(module, name)\n"
    )
    (modules / "my_channels_of_a_test.py").write_text(MODULE)
    importlib.import_module("lazy_of_a_test")
    recipe = {"class_path": "lazy_of_a_test.Mine", "init_args": {}, "factory": True}
    with pytest.raises(ValueError, match="cannot be imported"):
        from_recipe(recipe)
    assert not (modules / "trace").exists()
    assert from_recipe(recipe, ("lazy_of_a_test",)).__name__ == "Mine"


def test_a_file_may_move_within_its_package(modules):
    package = modules / "moving_of_a_test"
    package.mkdir()
    (package / "__init__.py").write_text("from moving_of_a_test.old import Mine\n")
    (package / "old.py").write_text(MODULE)
    recipe = to_recipe(importlib.import_module("moving_of_a_test").Mine)
    assert recipe["class_path"] == "moving_of_a_test.Mine"
    for name in ("moving_of_a_test", "moving_of_a_test.old"):
        del sys.modules[name]
    (package / "old.py").rename(package / "new.py")
    (package / "__init__.py").write_text("from moving_of_a_test.new import Mine\n")
    importlib.invalidate_caches()
    moved = from_recipe(recipe, ["moving_of_a_test"])
    assert moved.func.__module__ == "moving_of_a_test.new"


@pytest.mark.parametrize(
    ("value", "path"),
    [
        (PredatorPrey(), "bra.PredatorPrey"),
        (MLP, "bra.channels.MLP"),
        (ScoreFunction(), "bra.update_rules.ScoreFunction"),
        (RunningMarginals(), "bra.marginals.RunningMarginals"),
        (Adam, "torch.optim.Adam"),
        (nn.Tanh, "torch.nn.Tanh"),
        (Discrete(2), "gymnasium.spaces.Discrete"),
    ],
)
def test_classes_stand_under_their_public_paths(value, path):
    assert to_recipe(value)["class_path"] == path


@pytest.mark.parametrize(
    ("left", "right", "same"),
    [
        (1, 1, True),
        (1, 1.0, True),
        (1, True, False),
        ("a", "b", False),
        (None, None, True),
        ([1, 2], [1, 2], True),
        ([1, 2], [1], False),
        ([1, 2], [2, 1], False),
        ({"a": 1}, {"a": 1}, True),
        ({"a": 1}, {"b": 1}, False),
        ({"a": 1}, {"a": 1, "b": None}, False),
        (torch.ones(2), torch.ones(2), True),
        (torch.ones(2), torch.ones(3), False),
        (torch.ones(2), torch.zeros(2), False),
        (torch.ones(2), [1.0, 1.0], False),
        ({"a": [torch.ones(2)]}, {"a": [torch.ones(2)]}, True),
        (OrderedDict(a=1, b=2), OrderedDict(b=2, a=1), True),
    ],
)
def test_same_recipe(left, right, same):
    assert same_recipe(left, right) is same
    assert same_recipe(right, left) is same


@pytest.mark.parametrize(
    ("value", "line"),
    [
        (PredatorPrey("mating"), "PredatorPrey(variant=mating, observations=binary)"),
        (partial(Table, spread=0.5), "Table(spread=0.5, start=None, covering_logit=5.0)"),
        (torch.zeros(2, 3), "<2×3>"),
        (Discrete(4), "Discrete(n=4)"),
        (3, "3"),
    ],
)
def test_recipes_in_one_line(value, line):
    assert describe_recipe(to_recipe(value)) == line
