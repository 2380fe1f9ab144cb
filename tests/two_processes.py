"""Every kind of agent, trained in this process alone and in two together."""

import logging
import multiprocessing
import os
from functools import partial
from multiprocessing.process import BaseProcess
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


def train_all(folder: Path, processes: int = 1, rank: int = 0) -> None:
    """Leaves what was learnt and told in files of the processes' number and this one's rank."""
    path = folder / f"{processes}_{rank}.pt"
    told = logging.FileHandler(path.with_suffix(".log"))
    log = logging.getLogger("bra")
    level = log.level
    log.setLevel(logging.INFO)
    log.addHandler(told)
    states = {}
    for name, make in KINDS.items():
        for batch_size in (5,) if name == "batch marginals" else (1, 4):
            learner = make(seed=0, compile=processes > 1)  # where there is one line, and no blocks
            states[f"{name}, {batch_size}"] = train(learner, batch_size, processes)
    log.removeHandler(told)
    log.setLevel(level)
    torch.save(states, path)


def train_together(folder: Path, port: str, rank: int) -> None:
    torch.set_num_threads(1)
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2"}
    os.environ |= {"LOCAL_RANK": str(rank), "NODE_RANK": "0"}
    train_all(folder, 2, rank)


def start_two(folder: Path, port: str) -> list[BaseProcess]:
    """Two that train together; forked, since to import all takes longest, where torch allows it."""
    way = multiprocessing.get_context("spawn" if torch.accelerator.is_available() else "fork")
    two = [
        way.Process(target=train_together, args=(folder, port, rank), daemon=True)
        for rank in range(2)
    ]
    for process in two:
        process.start()
    return two
