"""What watching costs: seconds inside the monitors over seconds of training.

    python benchmarks/monitors.py [updates]

Trains predator-prey from samples, with all monitors at their default intervals and a TensorBoard
logger, and measures the wall time spent inside each monitor's hooks. Everything that TensorBoard's
writer thread does is part of the total.
"""

import sys
import tempfile
import time
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from lightning.pytorch.loggers import TensorBoardLogger

from bra import Agent, PredatorPrey, RolloutDataModule
from bra.callbacks import BaselineMonitor, BehaviourFigures, InformationMonitor, RunSummary
from bra.channels import MLP
from bra.update_rules import ScoreFunction

HOOKS = (
    "on_fit_start",
    "on_train_start",
    "on_train_batch_end",
    "on_train_end",
    "on_fit_end",
)


def clocked(callback: pl.Callback, seconds: dict[str, float]) -> pl.Callback:
    """Adds up the time that a callback's hooks take."""
    name = type(callback).__name__

    def clock(hook: Any) -> Any:
        def timed(*args: Any) -> None:
            start = time.perf_counter()
            hook(*args)
            seconds[name] += time.perf_counter() - start

        return timed

    for hook in HOOKS:
        setattr(callback, hook, clock(getattr(callback, hook)))
    return callback


def main(updates: int) -> None:
    """Trains once and prints the shares."""
    torch.set_num_threads(1)
    seconds: dict[str, float] = defaultdict(float)
    monitors = (InformationMonitor(), BaselineMonitor(), BehaviourFigures(), RunSummary())
    agent = Agent(
        PredatorPrey(),
        partial(MLP, hidden=[20]),
        percepts=13,
        beta_perception=8.0,
        beta_action=10.0,
        update_rule=ScoreFunction(samples=4, baseline="leave-one-out"),
        seed=0,
    )
    with tempfile.TemporaryDirectory() as folder:
        trainer = pl.Trainer(
            max_steps=updates,
            max_epochs=-1,
            logger=TensorBoardLogger(Path(folder)),
            callbacks=[clocked(monitor, seconds) for monitor in monitors],
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        start = time.perf_counter()
        trainer.fit(agent, RolloutDataModule(agent.task, 64, 1000))
        total = time.perf_counter() - start
    training = total - sum(seconds.values())
    print(f"{updates} updates, {1e6 * training / updates:.0f} µs each without monitors")
    for name, spent in seconds.items():
        print(f"{name:20} {spent:6.2f} s  {spent / training:6.2%} of the training time")
    print(f"{'all':20} {sum(seconds.values()):6.2f} s  {sum(seconds.values()) / training:6.2%}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
