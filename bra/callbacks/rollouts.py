"""What an agent did, as a table on disk."""

import csv
from collections.abc import Sequence
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

from bra.agent.run_folder import run_folder
from bra.callbacks.schedule import agent_of
from bra.checks.words import amount
from bra.tasks import FiniteStateTask, FiniteTask, Rollout


class RolloutWriter(pl.Callback):
    """Writes the encounters of a prediction into `rollouts.csv` in the log directory.

    Columns: state, percept, action (by name where they have one), utility.
    """

    @rank_zero_only
    def on_predict_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Writes one batch, and says where."""
        rollout: Rollout = outputs
        task = agent_of(pl_module).task
        states = task.state_names if isinstance(task, FiniteStateTask) else None
        actions = task.action_names if isinstance(task, FiniteTask) else None
        path = run_folder(trainer).file("rollouts.csv")
        with path.open("a" if batch_idx else "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if batch_idx == 0:
                writer.writerow(["state", "percept", "action", "utility"])
            writer.writerows(
                zip(
                    _labels(rollout.state, states),
                    _labels(rollout.percept, None),
                    _labels(rollout.action, actions),
                    rollout.utility.tolist(),
                    strict=True,
                )
            )
        print(f"{amount(len(rollout.utility), 'rollout')} in {path}")


def _labels(values: Tensor, names: Sequence[str] | None) -> list[Any]:
    return [names[value] for value in values.tolist()] if names else values.tolist()
