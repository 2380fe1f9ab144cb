"""The checkpoints of a run for which nobody has asked for others."""

import lightning.pytorch as pl
from lightning.pytorch.callbacks import ModelCheckpoint

from bra.agent.run_folder import run_folder


class RunCheckpoints(ModelCheckpoint):
    """Keeps `last.ckpt` and the checkpoint of the newest epoch, in the folder of the run."""

    def __init__(self) -> None:
        super().__init__(save_last=True)

    def setup(self, trainer: pl.Trainer, pl_module: pl.LightningModule, stage: str) -> None:
        """Finds the folder, which runs have without a logger, too."""
        own = str(run_folder(trainer).path / "checkpoints") if trainer.is_global_zero else None
        self.dirpath = trainer.strategy.broadcast(own)
        super().setup(trainer, pl_module, stage)
