"""Tasks: worlds to draw from, with a utility."""

from bra.tasks.base import Rollout, Task, World, WorldError
from bra.tasks.datamodule import RolloutDataModule
from bra.tasks.finite import FiniteStateTask, FiniteTask, TableTask, TargetTask
from bra.tasks.predator_prey import PredatorPrey

__all__ = [
    "FiniteStateTask",
    "FiniteTask",
    "PredatorPrey",
    "Rollout",
    "RolloutDataModule",
    "TableTask",
    "TargetTask",
    "Task",
    "World",
    "WorldError",
]
