"""Callbacks that send a signal to their own process, or take its folder away."""

import os
import shutil

import lightning.pytorch as pl


class SignalAfter(pl.Callback):
    """In training, after so many updates."""

    def __init__(self, number: int, updates: int) -> None:
        self.number, self.updates = number, updates

    def on_train_batch_start(self, trainer, pl_module, *_):
        if trainer.global_step == self.updates:
            os.kill(os.getpid(), self.number)


class SignalIn(pl.Callback):
    """In another phase, named by its hook."""

    def __init__(self, number: int, hook: str) -> None:
        setattr(self, hook, lambda *_: os.kill(os.getpid(), number))


class TakeFolder(pl.Callback):
    """Deletes the folder of the run after its first update."""

    def on_train_batch_end(self, trainer, pl_module, *_):
        shutil.rmtree(trainer.log_dir, ignore_errors=True)
