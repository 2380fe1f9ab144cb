"""Trains every kind of agent, in this process alone or as one of two; called by a test.

Usage: two_processes.py FOLDER [ADDRESS_PORT]
"""

import logging
import os
import sys
from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import torch

from bra import Agent, Cooling, Population, PredatorPrey, RolloutDataModule
from bra.channels import MLP, Gaussian, Multinomial
from bra.critics import Exploration, NetworkCritic
from bra.tasks import TargetTask
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction

TASK = PredatorPrey()
TABLES = {"perception": MLP, "action": Multinomial, "percepts": 3}
KINDS = {
    "projection": partial(Agent, TASK, update_rule=Projection(rivals=Rivals()), **TABLES),
    "exact gradient": partial(Agent, TASK, update_rule=ExactGradient(), **TABLES),
    "score function": partial(
        Agent, TASK, update_rule=ScoreFunction(2, "running"), cooling=Cooling(), **TABLES
    ),
    "batch marginals": partial(
        Agent, TargetTask([[0.0], [1.0]]), MLP, Gaussian, update_rule=ScoreFunction()
    ),
    "critic": partial(
        Agent,
        TASK,
        update_rule=Projection(critic=NetworkCritic(), exploration=Exploration()),
        **TABLES,
    ),
    "population": partial(Population, TASK, 3, update_rule=ScoreFunction(), **TABLES),
}


def train(learner: Agent | Population, batch_size: int, processes: int) -> dict[str, torch.Tensor]:
    trainer = pl.Trainer(
        accelerator="cpu",
        devices=processes,
        strategy="ddp" if processes > 1 else "auto",
        max_epochs=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        gradient_clip_val=1.0,
    )
    trainer.fit(learner, RolloutDataModule(learner.task, batch_size, updates_per_epoch=6))
    assert learner.updates == 6 and learner.samples == 6 * batch_size
    return learner.state_dict()


def main(folder: Path, port: str = "") -> None:
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
    processes = 2 if port else 1
    if port:
        os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2"}
    states = {}
    for name, make in KINDS.items():
        for batch_size in (5,) if name == "batch marginals" else (1, 4):
            learner = make(seed=0, compile=processes > 1)  # where there is one line, and no blocks
            states[f"{name}, {batch_size}"] = train(learner, batch_size, processes)
    torch.save(states, folder / f"{processes}_{os.environ.get('LOCAL_RANK', 0)}.pt")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
