"""Tasks: worlds to draw from, with a utility."""

from bra.tasks.base import Rollout, Task, World, WorldError
from bra.tasks.datamodule import RolloutDataModule
from bra.tasks.finite import FiniteStateTask, FiniteTask, TableTask, TargetTask, knows_signals
from bra.tasks.nao_mugs import NaoMugs
from bra.tasks.predator_prey import PredatorPrey

__all__ = [
    "FiniteStateTask",
    "FiniteTask",
    "NaoMugs",
    "PredatorPrey",
    "Rollout",
    "RolloutDataModule",
    "TableTask",
    "TargetTask",
    "Task",
    "World",
    "WorldError",
    "knows_signals",
]
