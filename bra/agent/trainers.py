"""What an agent makes of a trainer's options, and which it cannot follow."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.fabric.plugins.environments.lightning import LightningEnvironment
from lightning.pytorch.callbacks import (
    BackboneFinetuning,
    BatchSizeFinder,
    GradientAccumulationScheduler,
    LearningRateFinder,
    StochasticWeightAveraging,
)
from lightning.pytorch.callbacks.spike import SpikeDetection
from lightning.pytorch.strategies import DDPStrategy, SingleDeviceStrategy
from torch import Tensor

from bra.agent.noise import leave_out_summary
from bra.checkpoints.files import read_checkpoint, write_checkpoint
from bra.checkpoints.recipes import describe_recipe, same_recipe, to_recipe
from bra.checks.failures import add_note
from bra.processes.endings import end_with_children, end_with_parent
from bra.tasks import FiniteTask, Task
from bra.tasks.base import WorldError, check_utility

STEERING = (
    BackboneFinetuning,
    BatchSizeFinder,
    GradientAccumulationScheduler,
    LearningRateFinder,
    SpikeDetection,
    StochasticWeightAveraging,
)
"""Callbacks that take over what an agent does by itself."""
WAYS_OUT = "Rates, their schedules and the size of batches are keys of model and data"
PRECISIONS = ("32-true", "64-true", "bf16-mixed", "16-mixed")


def check_trainer(trainer: pl.Trainer) -> None:
    """Refuses what an agent cannot follow, before processes are started or waited for.

    Raises:
        ValueError: If the strategy moves or pickles the agent, other nodes are to be waited for
            that nobody starts, parameters are of half precision, gradients are accumulated, numbers
            are out of range, or a callback takes over what an agent does by itself.
    """
    strategy = trainer.strategy
    start = getattr(strategy, "_start_method", "popen")
    if start != "popen" or not isinstance(strategy, DDPStrategy | SingleDeviceStrategy):
        name = type(strategy).__name__ if start == "popen" else f"ddp_{start}"
        raise ValueError(f"trainer.strategy must be auto or ddp, got {name}")
    alone = isinstance(getattr(strategy, "cluster_environment", None), LightningEnvironment)
    if alone and trainer.num_nodes > 1 and not {"MASTER_ADDR", "NODE_RANK"} <= os.environ.keys():
        raise ValueError(
            f"trainer.num_nodes {trainer.num_nodes} would wait for nodes that nobody starts; start "
            "the command by torchrun or SLURM, or set MASTER_ADDR, MASTER_PORT and NODE_RANK on "
            "each node"
        )
    if trainer.precision not in PRECISIONS:
        raise ValueError(
            f"trainer.precision must be one of {', '.join(PRECISIONS)}, got {trainer.precision}"
        )
    if trainer.accumulate_grad_batches != 1:
        raise ValueError(
            f"trainer.accumulate_grad_batches must be 1, got {trainer.accumulate_grad_batches}: "
            "each batch is an update; a larger data.batch_size averages over more worlds"
        )
    if trainer.gradient_clip_val and trainer.precision == "16-mixed":
        raise ValueError(
            "trainer.gradient_clip_val: gradients of precision 16-mixed are scaled; use "
            "precision bf16-mixed or 32-true"
        )
    _check_numbers(trainer)
    for callback in trainer.callbacks:  # type: ignore[attr-defined]  # set by a connector
        if isinstance(callback, STEERING):
            raise ValueError(
                f"{type(callback).__name__} works where Lightning has one loss and one optimizer, "
                f"an agent has two of them; leave it out. {WAYS_OUT}"
            )


def _check_numbers(trainer: pl.Trainer) -> None:
    same: float = trainer.overfit_batches  # type: ignore[attr-defined]  # set by a connector
    if same:
        raise ValueError(
            f"trainer.overfit_batches must be 0, got {same}: every batch is drawn anew; for few "
            "updates set data.updates_per_epoch and trainer.max_epochs"
        )
    never = "trainer.limit_val_batches 0 turns validation off"
    every, interval = trainer.check_val_every_n_epoch, trainer.val_check_interval
    if every is not None and every < 1:
        raise ValueError(
            f"trainer.check_val_every_n_epoch must be null or at least 1, got {every}; {never}"
        )
    if interval == 0:
        raise ValueError(f"trainer.val_check_interval must be positive, got {interval}; {never}")
    least = {
        "gradient_clip_val": trainer.gradient_clip_val,
        "log_every_n_steps": trainer.log_every_n_steps,  # type: ignore[attr-defined]  # as above
        "min_epochs": trainer.min_epochs,
        "min_steps": trainer.min_steps,
    }
    for name, number in least.items():
        if number is not None and not number >= 0:
            raise ValueError(f"trainer.{name} must be at least 0, got {number}")


def prepare(trainer: pl.Trainer) -> None:
    """Looks at a trainer's options; has it keep whole files, no processes that hang, and silence.

    Raises:
        ValueError: See `check_trainer`.
    """
    check_trainer(trainer)
    if type(trainer.strategy.checkpoint_io) is TorchCheckpointIO:
        trainer.strategy.checkpoint_io = WholeFiles()
    leave_out_summary(trainer)
    _end_together(trainer)


def _end_together(trainer: pl.Trainer) -> None:
    """Lets the processes of all ranks end as soon as one of them has failed."""
    if trainer.local_rank:
        end_with_parent()
    elif children := getattr(trainer.strategy.launcher, "procs", ()):
        end_with_children(children)


class WholeFiles(TorchCheckpointIO):
    """Writes checkpoints that are whole or not there at all, and reads no others."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None
    ) -> None:
        """Writes one.

        Raises:
            OSError: If it cannot be written.
        """
        write_checkpoint(checkpoint, path)

    def load_checkpoint(
        self, path: str | Path, map_location: Any = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        """Reads one, plain data and tensors only.

        Raises:
            ValueError: If it is damaged, or of something else.
        """
        return read_checkpoint(path, map_location)


class Naming(pl.Callback):
    """Notes in errors of somebody's own classes, callbacks too, whose they are and when."""

    def on_exception(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException
    ) -> None:
        """Notes it."""
        phase = trainer.state.fn.value if trainer.state.fn else "setup"
        add_note(exception, f"in update {pl_module.updates}" if phase == "fit" else f"in {phase}")


def check_worlds(trainer: pl.Trainer, task: Task) -> None:
    """Makes sure that there are worlds, those of an agent's task, and that they have utilities.

    Raises:
        ValueError: If the data module draws from another task.
        WorldError: If worlds or utilities of the task are not what they promise to be.
    """
    drawn = to_recipe(getattr(getattr(trainer, "datamodule", None), "task", task))
    own = to_recipe(task)
    if not same_recipe(drawn, own):
        raise ValueError(
            f"the data module draws worlds of {describe_recipe(drawn)}, the agent's task is "
            f"{describe_recipe(own)}; give both the same task"
        )
    if not isinstance(task, FiniteTask):
        check_utility(task)
    if trainer.datamodule is None:  # type: ignore[attr-defined]  # set by the connector
        trainer.fit_loop.setup_data()
        batch = next(iter(trainer.train_dataloader or ()), None)
        if batch is not None and not hasattr(batch, "state"):
            raise WorldError(
                f"agents learn from batches bra.World(state, observation), got a "
                f"{type(batch).__name__}; use RolloutDataModule(task)"
            )


def clip_gradients(trainer: pl.Trainer, gradients: Sequence[Tensor], stacked: bool) -> None:
    """Clips the gradients of a channel in place as the trainer's options say, by norm or by value.

    Args:
        trainer: Has the options.
        gradients: Of the channel's parameters.
        stacked: Whether their first dimension counts agents, each of which is clipped by itself.
    """
    limit = trainer.gradient_clip_val
    if not limit or not gradients:
        return
    if trainer.gradient_clip_algorithm == "value":
        for gradient in gradients:
            gradient.clamp_(-limit, limit)
    else:
        clip_norm([g if stacked else g.unsqueeze(0) for g in gradients], limit)


def clip_norm(gradients: Sequence[Tensor], limit: float) -> None:
    """Scales gradients, (R, …) each, in place, so that no agent's norm over all exceeds a limit."""
    norm = torch.stack([g.flatten(1).square().sum(1) for g in gradients]).sum(0).sqrt()
    factor = (limit / (norm + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(factor.reshape(-1, *[1] * (gradient.ndim - 1)))
