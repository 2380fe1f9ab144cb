"""Commands that work on a configuration: `bra fit`, `baseline`, `frontier` and their like."""

import logging
import os
import re
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import lightning.pytorch as pl
import torch
from jsonargparse import Namespace
from lightning.fabric.plugins.environments.lightning import LightningEnvironment
from lightning.fabric.plugins.environments.slurm import SLURMEnvironment
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Checkpoint, ProgressBar
from lightning.pytorch.cli import ArgsType, LightningArgumentParser, LightningCLI

from bra.agent.noise import leave_out_noise
from bra.agent.run_folder import best_checkpoint, last_checkpoint
from bra.agent.trainers import check_trainer
from bra.callbacks import RunCheckpoints, UpdateBar
from bra.callbacks.monitors import MONITORS
from bra.checkpoints import files as checkpoints
from bra.checkpoints.files import CheckpointError
from bra.checkpoints.recipes import class_path
from bra.checks.failures import add_note, find_note, house_line, own_line, own_text
from bra.checks.memory import TooLarge, limited_memory, missing_memory
from bra.cli.alone import COMMANDS as LOOKING
from bra.cli.alone import lone_checkpoint, settings_of, trusted_modules
from bra.cli.configurations import configuration_folders, hollow_keys, is_known
from bra.cli.errors import explain, fail, suggest
from bra.cli.interruption import Interruption
from bra.cli.model import make_model
from bra.cli.parser import ArgumentParser, ConfigWriter
from bra.cli.patience import Progress, patience
from bra.cli.start import COMMANDS
from bra.cli.trainer import Trainer
from bra.processes.endings import PARENT, PAUSE
from bra.tasks import RolloutDataModule, WorldError

FOUND = {"last": last_checkpoint, "best": best_checkpoint}
"""Checkpoints that need no path."""
TRAINER_DEFAULTS = {
    "max_epochs": 10,
    "devices": 1,
    "num_sanity_val_steps": 0,
    "enable_model_summary": False,
}
FORESEEN = (CheckpointError, FloatingPointError, MisconfigurationException, OSError, TooLarge)
"""Errors whose words are for everybody."""
FLAGS = ("--json", "--grid", "--agents")
_show = warnings.showwarning


def run_command(command: str, args: Sequence[str]) -> None:
    """Runs a command with the keys that follow it."""
    folders = configuration_folders(args)
    sys.path += [folder for folder in folders if folder not in sys.path]
    progress = Progress(f"bra {command}")
    quieten(progress)
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)  # channels are small: more threads only wait for each other
    args = [f"{arg}=true" if arg in FLAGS else arg for arg in args]
    try:
        with patience(progress), limited_memory():
            BraCLI(command, args, folders, progress)
    except BrokenPipeError:
        raise
    except Exception as error:
        add_note(error, f"in bra {command}")
        print(file=sys.stderr)  # ends the line of the progress bar
        fail(tell(error, progress))


def tell(error: Exception, progress: Progress) -> str:
    """An error in one line, after the traceback of code of one's own.

    Raises:
        Exception: The same, if `bra` itself raised what nobody has foreseen.
    """
    if isinstance(error, WorldError):
        return "; ".join(filter(None, (str(error), find_note(error))))
    if find_note(error):
        print(own_text(error), file=sys.stderr)
        return own_line(error)
    if isinstance(error, FileNotFoundError) and error.filename:
        path = os.fsdecode(error.filename)
        return f"there is no {path}, or no folder for it; was it deleted while the command ran?"
    if line := missing_memory(error):
        return f"{progress} has no room: {line}{progress.large()}; take less"
    line = house_line(error)
    if isinstance(error, FORESEEN) or (isinstance(error, ValueError) and not line):
        return str(error)
    if isinstance(error, RuntimeError) and re.search("gloo|nccl", str(error), re.IGNORECASE):
        time.sleep(2 * PAUSE)  # whoever watches the processes may know more
        return "a process of another rank is gone; resume from the last checkpoint"
    if not line:
        raise error
    return line


def quieten(progress: Progress | None = None) -> None:
    """Keeps what Lightning has to tell out of the terminal, lets progress and our warnings through.

    Our warnings are a line, without the place in our code that they come from. Lines that tell of
    progress are counted, if somebody counts them.
    """
    log, handler = logging.getLogger("bra"), logging.StreamHandler()  # on standard error of now
    if progress is not None:
        handler.addFilter(progress)
    log.setLevel(logging.INFO)
    log.handlers = [handler]
    leave_out_noise()
    warnings.showwarning = _warn  # type: ignore[assignment]  # of the same arguments


def _warn(message: Warning | str, category: type[Warning], file: str, *where: Any) -> None:
    if Path(file).is_relative_to(Path(__file__).parents[1]):
        print(f"warning: {message}", file=sys.stderr)
    else:
        _show(message, category, file, *where)


class BraCLI(LightningCLI):
    """LightningCLI for an agent, its data and its monitors.

    Args:
        command: The one command that is parsed and run.
        args: What follows it.
        folders: Where classes that the configuration names may lie.
        progress: Is told of it, if given.
    """

    def __init__(
        self,
        command: str,
        args: Sequence[str],
        folders: Sequence[str] = (),
        progress: Progress | None = None,
    ) -> None:
        self.command = command
        if progress is not None:
            progress.cli = self
        self.alone = lone_checkpoint(command, args)
        self.trusted = trusted_modules(args) if self.alone else []
        if self.trusted:
            folders = [*folders, os.getcwd()]
            sys.path.append(os.getcwd())
        super().__init__(
            make_model,
            RolloutDataModule,
            trainer_class=Trainer,
            parser_class=ArgumentParser,
            seed_everything_default=0,
            save_config_callback=ConfigWriter,
            save_config_kwargs={"save_to_log_dir": False, "folders": folders},
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,
            args=[command, *args],
        )

    def subcommands(self) -> dict[str, set[str]]:  # type: ignore[override]  # not all: parsers take time
        """The command, of Lightning's and our own, and what of it is no key."""
        own = {name: {"model", "datamodule"} for name in ("baseline", "frontier")}
        known = LightningCLI.subcommands() | own
        return {self.command: known[self.command]}

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Puts agent and data first, Lightning's many keys last."""
        parser.description = COMMANDS[self.command]
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
                default={"class_path": class_path(monitor)},
                help=f"{(monitor.__doc__ or '').partition(chr(10))[0]} `null` turns it off.",
            )
        if self.command in LOOKING:
            parser.add_argument(
                "--trusted",
                type=Sequence[str] | str,
                default=[],
                help="Modules of one's own that a checkpoint without configuration may import.",
            )
        if self.alone:
            parser.set_defaults(settings_of(self.alone, self.trusted))
        parser.link_arguments("data.task", "model.task", apply_on="instantiate")
        parser.link_arguments("seed_everything", "model.seed", compute_fn=_seed)

    def parse_arguments(self, parser: LightningArgumentParser, args: ArgsType) -> None:
        """Parses, and looks at the checkpoint before anything is built."""
        super().parse_arguments(parser, args)
        config = self.config[self.config.subcommand]
        for key in hollow_keys(cast(Sequence[str], args)):
            if not is_known(config, key):
                fail(f"unknown key {'.'.join(key)}; {suggest('.'.join(key), config.keys())}")
        seed, path = config.seed_everything, config.get("ckpt_path")
        outside = os.environ.get("PL_GLOBAL_SEED", "0")
        if seed is True and not (outside.isdecimal() and int(outside) < 2**32):
            fail(f"PL_GLOBAL_SEED must be at least 0 and less than 2³², got {outside}")
        if not isinstance(seed, bool) and not 0 <= seed < 2**32:
            fail(f"seed_everything must be at least 0 and less than 2³², got {seed}")
        self.checkpoint: dict[str, Any] | None = None
        if path and path not in FOUND:
            self._read_checkpoint(path)
        elif not path and self.config.subcommand in ("validate", "test", "predict"):
            print("warning: without --ckpt_path the agent is untrained", file=sys.stderr)

    def _read_checkpoint(self, path: str) -> None:
        try:
            self.checkpoint = checkpoints.read_checkpoint(path, "cpu")
        except OSError as error:
            fail(f"ckpt_path: cannot read {path}: {error.strerror}")
        except ValueError as error:
            fail(f"ckpt_path: {error}")

    def _find_checkpoint(self, command: Namespace) -> None:
        """Puts a file in the place of `last` and `best`."""
        try:
            command.ckpt_path = str(FOUND[command.ckpt_path](self.trainer))
        except (ValueError, OSError) as error:
            fail(f"ckpt_path {command.ckpt_path}: {error}")
        print(f"from {command.ckpt_path}", file=sys.stderr)
        self._read_checkpoint(command.ckpt_path)

    def _parse_ckpt_path(self) -> None:
        """Takes no settings from a checkpoint: they could name any class, and import it."""

    def instantiate_classes(self) -> None:
        """Builds agent, data and trainer; what their constructors refuse becomes one line."""
        try:
            super().instantiate_classes()
            check_trainer(self.trainer)
            if "LOCAL_RANK" not in os.environ:
                os.environ[PARENT] = str(os.getpid())
            command: Namespace = self.config_init[self.subcommand]
            if command.get("ckpt_path") in FOUND:
                self._find_checkpoint(command)
            if self.checkpoint is not None:
                saved = self.checkpoint[checkpoints.KEY]["recipe"]
                checkpoints.check_same_parts(saved, self.model.recipe)
        except (ValueError, TypeError, ImportError, MisconfigurationException) as error:
            fail(explain(str(error)))
        if "weights_only" in command and command.weights_only is None:
            command.weights_only = True

    def instantiate_trainer(self, **kwargs: Any) -> pl.Trainer:
        """Adds the monitors, a progress bar, and `last.ckpt`, unless there are others.

        A barebones trainer gets none of them.
        """
        trainer_config = self._get(self.config_init, "trainer")
        callbacks, plugins = (_as_list(trainer_config.get(n)) for n in ("callbacks", "plugins"))
        alone = str(trainer_config.devices) == "1" and trainer_config.num_nodes == 1
        if alone and SLURMEnvironment.detect():  # whose other tasks are none of this run's
            kwargs["plugins"] = [*plugins, LightningEnvironment()]
        ranks = [name for name in ("RANK", "LOCAL_RANK") if os.environ.get(name, "0") != "0"]
        if alone and ranks:
            raise ValueError(
                f"this run is on one device, and the variable {ranks[0]} says that the process is "
                f"number {os.environ[ranks[0]]} of several; unset it, or set trainer.devices"
            )
        if trainer_config.barebones:
            return super().instantiate_trainer(callbacks=[*callbacks, Interruption()], **kwargs)
        callbacks += [m for name in MONITORS if (m := self._get(self.config_init, name))]
        wants_bar = trainer_config.get("enable_progress_bar") is not False
        if wants_bar and not any(isinstance(c, ProgressBar) for c in callbacks):
            callbacks.append(UpdateBar())
        wants_checkpoints = trainer_config.get("enable_checkpointing") is not False
        if wants_checkpoints and not any(isinstance(c, Checkpoint) for c in callbacks):
            callbacks.append(RunCheckpoints())
        callbacks.append(Interruption())
        return super().instantiate_trainer(callbacks=callbacks, **kwargs)


def _as_list(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given] if given else []


def _seed(seed: int | bool) -> int | None:
    return None if isinstance(seed, bool) else seed
