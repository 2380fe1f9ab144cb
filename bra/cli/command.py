"""The command `bra`."""

import itertools
import json
import logging
import os
import sys
import warnings
from argparse import ArgumentError
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NoReturn

import lightning.pytorch as pl
import torch
from jsonargparse import Namespace
from jsonargparse.typing import Path as JsonargparsePath
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Checkpoint, ModelCheckpoint, ProgressBar
from lightning.pytorch.cli import (
    ArgsType,
    LightningArgumentParser,
    LightningCLI,
    SaveConfigCallback,
)

from bra.agent.agent import DEFAULT_ACTION_OPTIMIZER, DEFAULT_PERCEPTION_OPTIMIZER
from bra.agent.learner import Learner
from bra.blahut_arimoto import Serial
from bra.callbacks import (
    BaselineMonitor,
    BehaviourFigures,
    InformationMonitor,
    ObservationFrames,
    PopulationMonitor,
    RolloutWriter,
    RunSummary,
    UpdateBar,
)
from bra.callbacks.baseline import solve_optimum
from bra.callbacks.schedule import agent_of
from bra.checkpoints import files as checkpoints
from bra.cli.errors import explain
from bra.cli.model import make_model
from bra.cli.robot import outcomes, rollout
from bra.objective import bits
from bra.population.population import Population
from bra.tasks import RolloutDataModule, WorldError

MONITORS = {
    "information": InformationMonitor,
    "baseline": BaselineMonitor,
    "population": PopulationMonitor,
    "behaviour": BehaviourFigures,
    "frames": ObservationFrames,
    "summary": RunSummary,
    "rollouts": RolloutWriter,
}
TRAINER_DEFAULTS = {"max_epochs": 10, "num_sanity_val_steps": 0, "enable_model_summary": False}
OPTIMIZER_DEFAULTS = {  # those of Agent, in the form that a configuration can hold
    "perception_optimizer": {
        "class_path": "torch.optim.Adam",
        "init_args": DEFAULT_PERCEPTION_OPTIMIZER.keywords,
    },
    "action_optimizer": {
        "class_path": "torch.optim.Adam",
        "init_args": DEFAULT_ACTION_OPTIMIZER.keywords,
    },
}
BESIDE = "# classes beside: "
"""Marks, in a saved configuration, where to look for the classes that it names."""
DESCRIPTION = (
    "Trains bounded-rational agents and holds them against the certified optimum. Two more "
    "commands let the robot act: `bra rollout` shows an agent, `bra outcomes` measures lifts."
)
ROBOT_COMMANDS: dict[str, Callable[..., None]] = {"rollout": rollout, "outcomes": outcomes}
COMMAND_KEYS = ("ckpt_path", "weights_only", "verbose", "return_predictions", "json")


def main(args: Sequence[str] | None = None) -> None:
    """Runs the command.

    Args:
        args: Arguments after the command's name; None takes those of the process.

    Raises:
        SystemExit: With code 2 after one line `error: …` on standard error, if the input is
            wrong.
    """
    args = list(sys.argv[1:] if args is None else args)
    for plugin in entry_points(group="bra.plugins"):
        plugin.load()
    for folder in config_folders(args):
        if folder not in sys.path:
            sys.path.insert(0, folder)  # channels and tasks may lie beside the YAML
    quieten()
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)  # channels are small: more threads only wait for each other
    try:
        if args and args[0] in ROBOT_COMMANDS:
            robot_command(ROBOT_COMMANDS[args[0]], args[1:])
        else:
            BraCLI(["--json=true" if arg == "--json" else arg for arg in args])
    except (FloatingPointError, MisconfigurationException, OSError, WorldError) as error:
        print(file=sys.stderr)  # ends the line of the progress bar
        fail(str(error))


def robot_command(function: Callable[..., None], args: Sequence[str]) -> None:
    """A command that needs no configuration: `bra rollout`, `bra outcomes`."""
    summary, *_ = (function.__doc__ or "").split("\n\n")
    parser = ArgumentParser(
        prog=f"bra {function.__name__}", description=summary, allow_abbrev=False
    )
    parser.add_function_arguments(function, as_group=False)
    settings = parser.parse_args(["--gui=true" if arg == "--gui" else arg for arg in args])
    try:
        function(**settings)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        fail(str(error))


def config_folders(args: Sequence[str]) -> Iterator[str]:
    """The folders of the configuration files on a command line, and those that they name."""
    for arg, following in itertools.pairwise([*args, ""]):
        option, _, value = arg.partition("=")
        if option in ("--config", "-c"):
            path = Path(value or following).resolve()
            yield str(path.parent)
            if path.is_file():
                for line in path.read_text(encoding="utf-8").splitlines():
                    if line.startswith(BESIDE):
                        yield line.removeprefix(BESIDE)


def quieten() -> None:
    """Keeps what is no news out of the terminal: hardware lists, tips, worker counts."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    logging.getLogger("lightning.fabric").setLevel(logging.WARNING)
    noise = (
        ".*does not have many workers",
        ".*log_every_n_steps",
        "The dirpath has changed from",
        "Using ModelCheckpoint with manual optimization",  # after the update is what we want
        ".*isinstance.treespec, LeafSpec",
        ".*args parameter is intended to run from within Python",
    )
    for message in noise:
        warnings.filterwarnings("ignore", message)


def fail(message: str) -> NoReturn:
    """Prints one line and exits with code 2."""
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(2)


class ArgumentParser(LightningArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Prints the line and exits with code 2."""
        failing = getattr(ex, "subcommand_parser", None) or self
        line = explain(message, failing.get_defaults(skip_validation=True).keys())
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

    def save_config(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:
        """Leaves out what belongs to one command only, and makes paths absolute."""
        config = self.config.clone()
        for key in COMMAND_KEYS:
            config.pop(key, None)
        for key, value in list(config.items()):
            if isinstance(value, JsonargparsePath):
                config[key] = value.absolute
            elif isinstance(value, type):  # a default that YAML cannot hold, such as Box's dtype
                config.pop(key)
        folder = Path(trainer.log_dir or trainer.default_root_dir)
        folder.mkdir(parents=True, exist_ok=True)
        text = self.parser.dump(config, skip_validation=True)
        beside = "".join(f"{BESIDE}{path}\n" for path in self.folders)
        (folder / self.config_filename).write_text(beside + text, encoding="utf-8")


class Trainer(pl.Trainer):
    """Lightning's trainer, and what can be done without training."""

    def baseline(
        self, model: Learner, datamodule: RolloutDataModule | None = None, json: bool = False
    ) -> None:
        """Solves for the Blahut-Arimoto optimum and prints it, without training.

        Args:
            model: States the problem.
            datamodule: Not used.
            json: Whether to print JSON, with information in nats, instead of a table.
        """
        agent = agent_of(model)
        if isinstance(model, Population) and len({s.prices for s in model.settings}) > 1:
            fail("baseline solves for one pair of prices, got lists; give one beta of each kind")
        optimum = solve_optimum(agent)
        if optimum is None:
            fail(
                f"baseline needs a task with a table of utilities and Discrete percepts, got "
                f"{type(agent.task).__name__} and {agent.percept_space}"
            )
        print(baseline_json(optimum) if json else baseline_text(optimum))


class BraCLI(LightningCLI):
    """LightningCLI for an agent, its data and its monitors."""

    def __init__(self, args: Sequence[str]) -> None:
        super().__init__(
            make_model,
            RolloutDataModule,
            trainer_class=Trainer,
            parser_class=ArgumentParser,
            parser_kwargs={"description": DESCRIPTION},
            seed_everything_default=0,
            save_config_callback=ConfigWriter,
            save_config_kwargs={
                "save_to_log_dir": False,
                "folders": list(config_folders(args)),
            },
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,
            args=list(args),
        )

    @staticmethod
    def subcommands() -> dict[str, set[str]]:
        """Lightning's commands, and `baseline`."""
        return {**LightningCLI.subcommands(), "baseline": {"model", "datamodule"}}

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Puts agent and data first, Lightning's many keys last."""
        parser.usage = "%(prog)s [--config FILE] [--KEY VALUE ...]"
        parser.add_lightning_class_args(make_model, "model")
        parser.add_lightning_class_args(RolloutDataModule, "data")
        parser.add_lightning_class_args(Trainer, "trainer")
        parser.set_defaults({f"trainer.{key}": value for key, value in TRAINER_DEFAULTS.items()})

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Adds the monitors, and hands task and seed to the agent."""
        for name, monitor in MONITORS.items():
            parser.add_argument(
                f"--{name}",
                type=monitor | None,
                default={"class_path": f"{monitor.__module__}.{monitor.__qualname__}"},
                help=f"{(monitor.__doc__ or '').splitlines()[0]} `null` turns it off.",
            )
        parser.set_defaults(
            {f"model.{key}": default for key, default in OPTIMIZER_DEFAULTS.items()}
        )
        parser.link_arguments("data.task", "model.task", apply_on="instantiate")
        parser.link_arguments("seed_everything", "model.seed", compute_fn=_seed)

    def parse_arguments(self, parser: LightningArgumentParser, args: ArgsType) -> None:
        """Parses, and looks at the checkpoint before anything is built."""
        super().parse_arguments(parser, args)
        config = self.config[self.config.subcommand]
        seed, path = config.seed_everything, config.get("ckpt_path")
        if not isinstance(seed, bool) and not 0 <= seed < 2**32:
            fail(f"seed_everything must be at least 0 and less than 2³², got {seed}")
        self.checkpoint = None
        if path:
            try:
                self.checkpoint = checkpoints.read_checkpoint(path, "cpu")
            except (ValueError, OSError) as error:
                fail(f"ckpt_path: {error}")
        elif self.config.subcommand in ("validate", "test", "predict"):
            print("warning: without --ckpt_path the agent is untrained", file=sys.stderr)

    def instantiate_classes(self) -> None:
        """Builds agent, data and trainer; what their constructors refuse becomes one line."""
        try:
            super().instantiate_classes()
            if self.checkpoint is not None:
                saved = self.checkpoint[checkpoints.KEY]["recipe"]
                checkpoints.check_same_parts(saved, self.model.recipe)
        except (ValueError, TypeError, ImportError, MisconfigurationException) as error:
            fail(explain(str(error)))
        command: Namespace = self.config_init[self.subcommand]
        if "weights_only" in command and command.weights_only is None:
            command.weights_only = True

    def instantiate_trainer(self, **kwargs: Any) -> pl.Trainer:
        """Adds the monitors, a progress bar, and `last.ckpt`, unless there are others."""
        trainer_config = self._get(self.config_init, "trainer")
        callbacks = list(trainer_config.get("callbacks") or [])
        callbacks += [m for name in MONITORS if (m := self._get(self.config_init, name))]
        wants_bar = trainer_config.get("enable_progress_bar") is not False
        if wants_bar and not any(isinstance(c, ProgressBar) for c in callbacks):
            callbacks.append(UpdateBar())
        wants_checkpoints = trainer_config.get("enable_checkpointing") is not False
        if wants_checkpoints and not any(isinstance(c, Checkpoint) for c in callbacks):
            callbacks.append(ModelCheckpoint(save_last=True))
        return super().instantiate_trainer(callbacks=callbacks, **kwargs)


def baseline_json(optimum: Serial) -> str:
    """The optimum for programs, information in nats."""
    return json.dumps(
        {
            "objective": optimum.objective,
            "expected_utility": optimum.expected_utility,
            "perception_information_nats": optimum.perception_information,
            "action_information_nats": optimum.action_information,
            "end_to_end_information_nats": optimum.end_to_end_information,
            "upper_bound": optimum.upper_bound,
            "tight_bound": optimum.tight_bound,
            "optima": optimum.optima.tolist(),
            "iterations": optimum.iterations,
            "converged": optimum.converged,
            "action_given_state": optimum.action_given_state.tolist(),
            "percept_given_state": optimum.percept_given_state.tolist(),
            "action_given_percept": optimum.action_given_percept.tolist(),
        },
        indent=2,
    )


def baseline_text(optimum: Serial) -> str:
    """The optimum for people, information in bits."""
    optima = optimum.optima
    best = int((optima > optima.max() - 1e-6).sum())
    return "\n".join(
        [
            f"J            {optimum.objective:.5f}   best of {len(optima)} starts; "
            f"{best} reach it, the worst stops at {optima.min().item():.5f}",
            f"upper bound  {optimum.upper_bound:.5f}   certified, whatever the percepts",
            f"tight bound  {optimum.tight_bound:.5f}   certified, for so many percepts",
            f"E[U]         {optimum.expected_utility:.5f}",
            f"I(Ω;X)       {bits(float(optimum.perception_information)):.4f} bits",
            f"I(X;A)       {bits(float(optimum.action_information)):.4f} bits",
            f"I(Ω;A)       {bits(float(optimum.end_to_end_information)):.4f} bits",
        ]
    )


def _seed(seed: int | bool) -> int | None:
    return None if isinstance(seed, bool) else seed
