"""What a command line may say, and what a run keeps of it."""

import re
import sys
import sysconfig
from argparse import ArgumentError
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn, cast

import lightning.pytorch as pl
import yaml
from gymnasium.spaces import Box, Discrete
from jsonargparse import Namespace, Unset, get_loader, set_loader, set_parsing_settings
from jsonargparse.typing import Path as JsonargparsePath
from lightning.pytorch.cli import LightningArgumentParser, SaveConfigCallback
from torch import Tensor

from bra.agent.defaults import Chosen
from bra.agent.learner import Learner
from bra.agent.run_folder import run_folder
from bra.checkpoints.recipes import Recipe, class_path
from bra.checks.failures import HOUSE
from bra.cli.configurations import BESIDE, compose
from bra.cli.errors import explain, fail
from bra.cli.pages import keys_page

COMMAND_KEYS = (
    *("ckpt_path", "weights_only", "verbose", "return_predictions", "json", "certify", "trusted"),
)
"""What belongs to one command only, and not to the configuration of a run."""
SETTLED = ("cooling", "update_rule")
"""Parts that may hold shares of the run."""

_load_yaml = get_loader("yaml")


def load_once(text: str) -> Any:
    """What YAML says, be it a file or a value on the command line.

    Raises:
        yaml.YAMLError: If it says a thing twice, or never comes to an end.
    """
    if "{" in text or "\n" in text:
        compose(text)
    return _load_yaml(text)


set_loader("yaml", load_once, exceptions=(yaml.YAMLError,))
set_parsing_settings(unset_sentinel=True)  # so that null is looked at like other values


class ArgumentParser(LightningArgumentParser):
    """A parser that takes whole names, whose errors are a line and whose help is a page."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, allow_abbrev=False, **kwargs)

    def dump(self, namespace: Namespace, *args: Any, **kwargs: Any) -> str:
        """Writes null for what is null, and for what nobody has set."""
        shown = namespace.clone()
        for key, value in namespace.items():
            shown[key] = None if value is Unset else value
        set_parsing_settings(unset_sentinel=False)  # where null is no value among others
        try:
            return str(super().dump(shown, *args, **kwargs))
        finally:
            set_parsing_settings(unset_sentinel=True)

    def format_help(self, formatter: Any = None) -> str:
        """Keys with types and defaults; of Lightning's trainer the names."""
        return keys_page(self)

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Prints the line and exits with code 2."""
        failing = getattr(ex, "subcommand_parser", None) or self
        line = explain(message, failing.get_defaults(skip_validation=True).keys(branches=True))
        if not self.exit_on_error:  # a class's own parser, whose caller has more to say
            raise ArgumentError(None, line) from ex
        fail(line)


class ConfigWriter(SaveConfigCallback):
    """Writes `config.yaml` into the log directory so that every command can be run from it.

    Args:
        folders: Where the classes that it names may lie.
        args: As for Lightning's callback.
        kwargs: As for Lightning's callback.
    """

    def __init__(self, *args: Any, folders: Sequence[str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.folders = folders

    def setup(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:
        """Writes, unless the length of the run is still to be found out."""
        if stage != "fit":
            super().setup(trainer, pl_module, stage)

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Writes, with shares of the run as they were settled."""
        cast(Learner, pl_module).settle()
        super().setup(trainer, pl_module, "fit")

    def save_config(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:
        """Leaves out what belongs to one command only, and writes the rest to last.

        What was left to choose is written as it was chosen, and shares of the run as updates.
        """
        config = self.config.clone()
        for key in COMMAND_KEYS:
            config.pop(key, None)
        recipe = cast(Learner, pl_module).recipe
        config.seed_everything = recipe["seed"]
        for part in fields(Chosen):
            if config.model.get(part.name) is None or part.name in SETTLED:
                config.model[part.name] = as_setting(recipe[part.name])
        make_lasting(config)
        drop_nulls(config, self.parser.get_defaults(skip_validation=True))
        text = self.parser.dump(config, skip_none=False, skip_validation=True)
        folders = dict.fromkeys([*self.folders, *own_folders(text)])
        beside = "".join(f"{BESIDE}{path}\n" for path in folders)
        path = run_folder(trainer).file(self.config_filename)
        path.write_text(beside + text, encoding="utf-8")


def own_folders(text: str) -> Iterator[str]:
    """Where the modules of one's own lie that a configuration names, unless they are installed."""
    installed = {sysconfig.get_path(name) for name in ("purelib", "platlib")}
    for name in dict.fromkeys(re.findall(r"class_path: ([^\W\d]\w*)\.", text)):
        file = getattr(sys.modules.get(name), "__file__", None)
        if name in HOUSE or file is None:
            continue
        folder = Path(file).resolve().parent
        folder = folder.parent if Path(file).stem == "__init__" else folder
        if str(folder) not in installed:
            yield str(folder)


def make_lasting(config: Namespace) -> None:
    """Makes paths of files absolute, and those of classes public."""
    for key, value in list(config.items()):
        if isinstance(value, JsonargparsePath):
            config[key] = value.absolute
        elif isinstance(value, type):  # a default that YAML cannot hold, such as Box's dtype
            config.pop(key)
        elif key.rpartition(".")[2] == "class_path":
            config[key] = class_path(resolve_name(value))
        for item in value if isinstance(value, list) else ():
            if isinstance(item, Namespace):
                make_lasting(item)


def drop_nulls(config: Namespace, defaults: Namespace) -> None:
    """Leaves out what is null by default; what somebody has turned off stays off."""
    for key, value in list(config.items()):
        if value is None and ".init_args." not in key and defaults.get(key) is None:
            config.pop(key)


def as_setting(recipe: Recipe) -> Any:
    """A recipe in the form that a configuration has."""
    match recipe:
        case Tensor():
            return recipe.tolist()
        case list():
            return [as_setting(item) for item in recipe]
        case dict() if recipe.get("class_path") == class_path(Discrete):
            return recipe["init_args"]["n"]
        case dict() if recipe.get("class_path") == class_path(Box):
            return _box_setting(**recipe["init_args"])
        case dict():
            return {key: as_setting(item) for key, item in recipe.items() if key != "factory"}
    return recipe


def _box_setting(low: Tensor, high: Tensor, dtype: str) -> dict[str, Any]:
    """A box that is the same along each number, as all are that a configuration can name."""
    sides = {"low": low.flatten()[0].item(), "high": high.flatten()[0].item()}
    return {"class_path": class_path(Box), "init_args": sides | {"shape": list(low.shape)}}
