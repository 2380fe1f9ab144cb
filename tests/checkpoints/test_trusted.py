"""What recipes may name, and what is imported for them."""

import importlib
import sys
from collections import OrderedDict
from functools import partial

import pytest
import torch
from gymnasium.spaces import Dict, Discrete
from torch import nn
from torch.optim import Adam

from bra.channels import MLP, Table
from bra.checkpoints.recipes import (
    Rebuildable,
    describe_recipe,
    from_recipe,
    same_recipe,
    to_recipe,
)
from bra.marginals import RunningMarginals
from bra.tasks import PredatorPrey
from bra.update_rules import ScoreFunction


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
    (package / "old.py").rename(package / "elsewhere.py")
    # Of another length: Python knows code that it has kept by second and size.
    (package / "__init__.py").write_text("from moving_of_a_test.elsewhere import Mine\n")
    importlib.invalidate_caches()
    moved = from_recipe(recipe, ["moving_of_a_test"])
    assert moved.func.__module__ == "moving_of_a_test.elsewhere"


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
