"""Runs of a small agent, in blocks and update by update."""

from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import training
from torch.optim import SGD

from bra import PredatorPrey
from bra.channels import MLP, Multinomial
from bra.update_rules import ScoreFunction

SETTINGS = {
    "task": PredatorPrey(),
    "perception": partial(MLP, hidden=[7]),
    "action": Multinomial,
    "percepts": 5,
    "beta_perception": 8.0,
    "beta_action": 10.0,
    "update_rule": ScoreFunction(baseline="running"),
    "perception_optimizer": partial(SGD, lr=0.05),
    "action_optimizer": partial(SGD, lr=0.1),
    "seed": 3,
    "compile": True,
}


class Looks(pl.Callback):
    """Sees the agent at every so many updates."""

    def __init__(self, every_n_updates: int | None) -> None:
        self.every_n_updates = every_n_updates
        self.seen: list[int] = []

    def on_train_batch_end(self, trainer, pl_module, *_):
        assert trainer.global_step == pl_module.updates
        self.seen.append(pl_module.updates)


def fit(learner, folder: Path, updates=150, batch_size=2, ckpt_path=None, **own) -> pl.Trainer:
    settings = {"max_epochs": 2, "accelerator": "cpu"} | own
    return training.fit(learner, folder, 0, ckpt_path, batch_size, updates, **settings)
