"""Trainings that are stopped by a signal."""

import shlex
import signal
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.callbacks import ModelCheckpoint

from bra.agent.learner import Learner
from bra.agent.run_folder import run_folder
from bra.cli.signals import stop


class Interruption(pl.Callback):
    """Ends a training after the update in which a signal came, and says how to go on.

    All that belongs to the end of a run follows: its checkpoint, its table and its summary.
    """

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Takes the signals, from Lightning too."""
        if stop.signal is None and signal.getsignal(signal.SIGINT) is stop:
            stop.install()
            stop.patient = True

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, *_: Any
    ) -> None:
        """Looks whether a signal came, to any of the processes."""
        came = stop.signal is not None
        if trainer.world_size > 1:
            came = trainer.strategy.reduce_boolean_decision(came, all=False)
        if came:
            stop.signal = stop.signal or signal.SIGTERM
            trainer.fit_loop.min_epochs, trainer.fit_loop.epoch_loop.min_steps = 0, None
            trainer.should_stop = True

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Saves what no other callback has saved."""
        stop.patient = False
        if stop.signal is None or not trainer.checkpoint_callbacks:
            return
        last = (c.last_model_path for c in trainer.checkpoint_callbacks if _is_current(c, trainer))
        self.path = next(filter(None, last), "")
        if not self.path:
            own = (
                str(run_folder(trainer).file("interrupted.ckpt")) if trainer.is_global_zero else ""
            )
            self.path = trainer.strategy.broadcast(own)
            trainer.save_checkpoint(self.path)

    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Says how to go on."""
        if stop.signal is None or not trainer.is_global_zero:
            return
        assert isinstance(pl_module, Learner)
        if not trainer.checkpoint_callbacks:
            print(f"stopped after {pl_module.updates:,} updates, without a checkpoint")
            return
        config = run_folder(trainer).file("config.yaml")
        command = ["bra", "fit", f"--config={config}", f"--ckpt_path={self.path}"]
        print(f"stopped after {pl_module.updates:,} updates; go on with\n  {shlex.join(command)}")


def _is_current(callback: Any, trainer: pl.Trainer) -> bool:
    return (
        isinstance(callback, ModelCheckpoint)
        and callback._last_global_step_saved == trainer.global_step
    )
