"""Trainings that are stopped by a signal."""

import shlex
import signal
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.callbacks import ModelCheckpoint

from bra.agent.learner import Learner
from bra.agent.run_folder import run_folder
from bra.checks.words import amount
from bra.cli.signals import stop


class Interruption(pl.Callback):
    """Ends a training after the update in which a signal came, and says how to go on.

    All that belongs to the end of a run follows: its checkpoint, its table and its summary.
    """

    every_n_updates = None  # wherever a block of updates ends

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Takes the signals, from Lightning too."""
        if stop.installed and stop.signal is None:
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
        kept = [c for c in trainer.checkpoint_callbacks if isinstance(c, ModelCheckpoint)]
        saved = [c for c in kept if c._last_global_step_saved == trainer.global_step]
        self.path = next((c.last_model_path for c in saved if c.last_model_path), "")
        if not self.path:
            if trainer.is_global_zero:
                self.path = str(run_folder(trainer).file("interrupted.ckpt"))
            self.path = trainer.strategy.broadcast(self.path)
            trainer.save_checkpoint(self.path)

    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Says how to go on."""
        if stop.signal is None or not trainer.is_global_zero:
            return
        assert isinstance(pl_module, Learner)
        updates = amount(pl_module.updates, "update")
        if not trainer.checkpoint_callbacks:
            print(f"stopped after {updates}, without a checkpoint")
            return
        config = run_folder(trainer).file("config.yaml")
        command = ["bra", "fit", f"--config={config}", f"--ckpt_path={self.path}"]
        print(f"stopped after {updates}; go on with\n  {shlex.join(command)}")
