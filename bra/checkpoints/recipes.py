"""Objects as plain data, so that a checkpoint alone rebuilds the agent, and rebuilds it safely.

A recipe is made of numbers, strings, lists, dicts and tensors only; `torch.load` takes it with
`weights_only=True`. An object is `{"class_path": …, "init_args": {…}}`, a factory (a class, or a
`functools.partial` of one) the same with `"factory": True`. A class stands under its public path,
so that its file may be moved. Reading a recipe imports nothing but modules of `bra` and those that
the caller trusts, and calls nothing but constructors of the kinds of class listed in `REBUILDABLE`.
"""

import importlib
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any, Self

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, Space
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

Recipe = Any
"""Nested plain data: None, bool, int, float, str, Tensor, list, dict."""


class Rebuildable:
    """Remembers the arguments that it was constructed with.

    A class whose arguments do not suffice, because they name a file that may move, say, overrides
    `init_arguments`.
    """

    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Keeps the arguments as given."""
        instance = super().__new__(cls)
        object.__setattr__(instance, "_arguments", (args, kwargs))
        return instance

    def __repr__(self) -> str:
        """The class and what it was given: `Cooling(start=4.0)`, tables by their shapes."""
        try:
            given = self.given_arguments()
        except TypeError:  # of a class whose constructor refused them
            return object.__repr__(self)
        return f"{type(self).__name__}({', '.join(f'{n}={_short(v)}' for n, v in given.items())})"

    def init_arguments(self) -> dict[str, Any]:
        """Returns keyword arguments that construct an equal object."""
        return _defaults(_signature(type(self).__init__)) | self.given_arguments()

    def given_arguments(self) -> dict[str, Any]:
        """Returns the arguments that it was constructed with, by name."""
        args, kwargs = self._arguments
        signature = _signature(type(self).__init__)
        _, *named = signature.bind(self, *args, **kwargs).arguments.items()
        return {
            key: value
            for name, argument in named
            for key, value in _named(signature.parameters[name], argument)
        }


REBUILDABLE = (Rebuildable, nn.Module, Optimizer, LRScheduler, Space)


@lru_cache
def _signature(constructor: Callable[..., None]) -> inspect.Signature:
    """Of a class's `__init__`, `self` included; to work it out takes longer than to use it."""
    return inspect.signature(constructor)


class UntrustedError(ValueError):
    """A class lies in a module that nobody has said to trust.

    Args:
        path: Of the class.
    """

    def __init__(self, path: str) -> None:
        self.needs = f"the checkpoint needs {path}, of a module that is not loaded"
        self.module = path.partition(".")[0]
        super().__init__(
            f"{self.needs}; if you trust its code, import it first, or load with "
            f"trusted=({self.module!r},)"
        )


def to_recipe(value: Any) -> Recipe:
    """Turns a value into its recipe.

    Raises:
        TypeError: If the value is, or contains, something that has no recipe.
    """
    match value:
        case np.generic():  # before float, of which np.float64 is a kind
            return value.item()
        case None | bool() | int() | float() | str():
            return value
        case Tensor() | np.ndarray():
            return torch.as_tensor(value).detach().cpu().clone()
        case list() | tuple():
            return [to_recipe(item) for item in value]
        case dict():
            return {str(key): to_recipe(item) for key, item in value.items()}
        case os.PathLike():
            return os.fspath(value)
        case Discrete():
            return _object_recipe(type(value), {"n": int(value.n)})
        case Box():
            box = {"low": value.low, "high": value.high, "dtype": value.dtype.name}
            return _object_recipe(type(value), box)
        case Rebuildable():
            return _object_recipe(type(value), value.init_arguments())
        case type() | partial():
            cls, arguments = unwrap_factory(value)
            if issubclass(cls, nn.Module):
                arguments = _defaults(inspect.signature(cls)) | arguments
            return {**_object_recipe(cls, arguments), "factory": True}
    raise TypeError(
        f"{value!r} cannot be written into a checkpoint; pass plain data, a class, a "
        "functools.partial of a class, or an object of a class derived from "
        "bra.checkpoints.Rebuildable"
    )


def unwrap_factory(factory: type | partial[Any]) -> tuple[type, dict[str, Any]]:
    """The class that a factory constructs, and the keyword arguments that it adds.

    jsonargparse makes `partial(instantiate, Class, **arguments)`, people `partial(Class, …)`.
    """
    if isinstance(factory, type):
        return factory, {}
    classes = [item for item in (factory.func, *factory.args) if isinstance(item, type)]
    if len(classes) != 1:
        raise TypeError(f"{factory!r} must be a functools.partial of one class")
    return classes[0], dict(factory.keywords)


def from_recipe(recipe: Recipe, trusted: str | Sequence[str] = ()) -> Any:
    """Rebuilds the value that `to_recipe` was given.

    Args:
        recipe: The value's recipe.
        trusted: Modules, or packages of such, that may be imported for it; or one of them.

    Raises:
        ValueError: If a class is of none of the kinds in `REBUILDABLE`, is not found, or lies in a
            module that is neither of `bra`, nor loaded, nor trusted.
    """
    if isinstance(recipe, list):
        return [from_recipe(item, trusted) for item in recipe]
    if not isinstance(recipe, dict):
        return recipe
    if "class_path" not in recipe:
        return {key: from_recipe(item, trusted) for key, item in recipe.items()}
    cls = _find_class(recipe["class_path"], trusted)
    arguments = from_recipe(recipe["init_args"], trusted)
    if recipe.get("factory"):
        return partial(cls, **arguments) if arguments else cls
    if issubclass(cls, Box):
        bounds = {side: arguments[side].numpy() for side in ("low", "high")}
        return cls(**bounds, dtype=np.dtype(arguments["dtype"]))
    return cls(**arguments)


def check_classes(recipe: Recipe, trusted: str | Sequence[str] = ()) -> None:
    """Looks whether a recipe may be rebuilt, without building anything.

    Raises:
        ValueError: As `from_recipe`.
    """
    if isinstance(recipe, dict):
        if "class_path" in recipe:
            _find_class(recipe["class_path"], trusted)
        recipe = list(recipe.values())
    for item in recipe if isinstance(recipe, list) else ():
        check_classes(item, trusted)


def is_recipe(recipe: Recipe) -> bool:
    """Whether all that names a class says with which arguments it is made."""
    if isinstance(recipe, dict):
        named = isinstance(recipe.get("class_path", ""), str)
        given = "class_path" not in recipe or isinstance(recipe.get("init_args"), dict)
        return named and given and all(map(is_recipe, recipe.values()))
    return all(map(is_recipe, recipe)) if isinstance(recipe, list) else True


def class_path(cls: type) -> str:
    """Where a class is to be found, whatever file it lies in: the shortest package that has it."""
    parts, name = cls.__module__.split("."), cls.__qualname__
    packages = (".".join(parts[: end + 1]) for end in range(len(parts)))
    public = (p for p in packages if getattr(sys.modules.get(p), name, None) is cls)
    return f"{next(public, cls.__module__)}.{name}"


def same_recipe(left: Recipe, right: Recipe) -> bool:
    """Whether two recipes are equal, tensors by value."""
    if isinstance(left, Tensor) and isinstance(right, Tensor):
        return torch.equal(left, right)
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(same_recipe(left[k], right[k]) for k in left)
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(same_recipe, left, right))
    return isinstance(left, bool) is isinstance(right, bool) and bool(left == right)


def with_defaults(recipe: Recipe) -> Recipe:
    """A recipe with the plain arguments that its class would fill in, if that is loaded.

    Configurations name all arguments of an optimizer, say, people only some.
    """
    if not isinstance(recipe, dict) or "class_path" not in recipe:
        return recipe
    home, _, name = recipe["class_path"].rpartition(".")
    cls = getattr(sys.modules.get(home), name, None)
    found = {}
    for key, value in _defaults(inspect.signature(cls)).items() if isinstance(cls, type) else ():
        with suppress(TypeError):
            found[key] = to_recipe(value)
    return recipe | {"init_args": found | recipe["init_args"]}


def describe_recipe(recipe: Recipe) -> str:
    """One line for people: `PredatorPrey(variant=hunting)`."""
    if isinstance(recipe, Tensor):
        return f"<{'×'.join(map(str, recipe.shape))}>"
    if isinstance(recipe, dict) and "class_path" in recipe:
        arguments = ", ".join(f"{k}={describe_recipe(v)}" for k, v in recipe["init_args"].items())
        return f"{recipe['class_path'].rpartition('.')[2]}({arguments})"
    return str(recipe)


def _short(value: Any) -> str:
    """A value for people; a table by its shape, a long list by its length."""
    if isinstance(value, Tensor | np.ndarray):
        return f"<{'×'.join(map(str, value.shape))}>"
    if isinstance(value, list | tuple) and len(repr(value)) > 40:
        return f"<{len(value)}>"
    return value.__name__ if isinstance(value, type) else repr(value)


def _object_recipe(cls: type, arguments: dict[str, Any]) -> dict[str, Recipe]:
    if not issubclass(cls, REBUILDABLE):
        raise TypeError(f"{cls.__qualname__} cannot be rebuilt from a checkpoint")
    return {
        "class_path": class_path(cls),
        "init_args": to_recipe(arguments),
    }


def _defaults(signature: inspect.Signature) -> dict[str, Any]:
    """Keyword arguments that a class would fill in itself, so that equal objects look equal."""
    parameters = signature.parameters.values()
    return {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}


def _named(parameter: inspect.Parameter, argument: Any) -> Iterable[tuple[str, Any]]:
    """A bound argument as keyword arguments: several for **kwargs."""
    if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
        raise TypeError(f"arguments {argument} need names to be written into a checkpoint")
    if parameter.kind is inspect.Parameter.VAR_KEYWORD:
        return list(argument.items())
    return [(parameter.name, argument)]


def _find_class(path: str, trusted: str | Sequence[str]) -> type:
    """The class of this path, if it may be found and used."""
    home, _, name = path.rpartition(".")
    modules = ("bra", trusted) if isinstance(trusted, str) else ("bra", *trusted)
    may_import = any(f"{home}.".startswith(f"{module}.") for module in modules)
    if home and not may_import and home not in sys.modules:
        raise UntrustedError(path)
    if home == "__main__" and name not in vars(sys.modules[home]):
        raise ValueError(
            f"the checkpoint needs {name}, a class of the script that trained it; load it in that "
            "script, or train with the class in a module of its own, which can be imported"
        )
    try:
        module = importlib.import_module(home)
        # Asked by name, a module may import others; of one that is merely loaded, nothing is asked.
        cls = getattr(module, name) if may_import else vars(module)[name]
    except (ImportError, AttributeError, LookupError, ValueError) as error:
        raise ValueError(
            f"the checkpoint needs {path}, which cannot be imported ({error}); "
            "put its folder on PYTHONPATH"
        ) from error
    if not (isinstance(cls, type) and issubclass(cls, REBUILDABLE)):
        raise ValueError(f"the checkpoint asks for {path}, which no agent is made of; refused")
    return cls
