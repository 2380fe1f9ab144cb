"""Short runs, and whether two of them ended alike."""

from pathlib import Path

import lightning.pytorch as pl
import torch

from bra import Agent, RolloutDataModule
from bra.agent import Learner

UPDATES_PER_EPOCH = 10


def make_trainer(folder: Path, **own) -> pl.Trainer:
    settings = {
        "logger": False,
        "enable_checkpointing": False,
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "num_sanity_val_steps": 0,
        "default_root_dir": folder,
    }
    return pl.Trainer(**(settings | own))


def fit(
    agent: Learner,
    folder: Path,
    workers: int = 0,
    ckpt_path=None,
    batch: int = 4,
    updates: int = UPDATES_PER_EPOCH,
    **trainer,
) -> pl.Trainer:
    data = RolloutDataModule(agent.task, batch, updates, workers=workers)
    trainer = make_trainer(folder, **trainer)
    trainer.fit(agent, data, ckpt_path=ckpt_path, weights_only=True)
    return trainer


def assert_same_state(one: Agent, other: Agent) -> None:
    assert one.updates == other.updates
    assert one.samples == other.samples
    ours, theirs = one.state_dict(), other.state_dict()
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        assert torch.equal(tensor, theirs[name]), name
