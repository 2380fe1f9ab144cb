"""Tasks: worlds to draw from, with a utility."""

from typing import TYPE_CHECKING, Any

from bra.tasks.base import Rollout, Task, World, WorldError
from bra.tasks.finite import FiniteStateTask, FiniteTask, knows_signals
from bra.tasks.medical import Medical
from bra.tasks.nao_mugs import NaoMugs
from bra.tasks.predator_prey import PredatorPrey
from bra.tasks.table import TableTask
from bra.tasks.target import TargetTask
from bra.tasks.taxonomy import Taxonomy

if TYPE_CHECKING:
    from bra.tasks.datamodule import RolloutDataModule

__all__ = [
    "FiniteStateTask",
    "FiniteTask",
    "Medical",
    "NaoMugs",
    "PredatorPrey",
    "Rollout",
    "RolloutDataModule",
    "TableTask",
    "TargetTask",
    "Task",
    "Taxonomy",
    "World",
    "WorldError",
    "knows_signals",
]


def __getattr__(name: str) -> Any:
    """Imports the data module, and with it Lightning, when it is asked for."""
    if name != "RolloutDataModule":
        raise AttributeError(f"module 'bra.tasks' has no attribute {name!r}")
    from bra.tasks.datamodule import RolloutDataModule

    return RolloutDataModule
