"""Bounded-rational perception-action agents, trained and held against the certified optimum."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bra import blahut_arimoto, callbacks, channels, critics, tasks, update_rules
    from bra.agent import Agent
    from bra.callbacks import monitors
    from bra.channels import Channel
    from bra.cooling import Cooling
    from bra.frontiers import frontier
    from bra.objective import Objective
    from bra.population import Population
    from bra.tasks import FiniteTask, PredatorPrey, RolloutDataModule, TableTask, Task, World

__all__ = [
    "Agent",
    "Channel",
    "Cooling",
    "FiniteTask",
    "Objective",
    "Population",
    "PredatorPrey",
    "RolloutDataModule",
    "TableTask",
    "Task",
    "World",
    "blahut_arimoto",
    "callbacks",
    "channels",
    "critics",
    "frontier",
    "monitors",
    "tasks",
    "update_rules",
]

_HOMES = {
    "Agent": "agent",
    "Channel": "channels",
    "Cooling": "cooling",
    "Objective": "objective",
    "Population": "population",
    "frontier": "frontiers",
    "monitors": "callbacks",
}


def __getattr__(name: str) -> Any:
    """Imports what is asked for when it is asked for: torch and Lightning take seconds."""
    if name in _HOMES or (name in __all__ and name[0].isupper()):
        return getattr(import_module(f"bra.{_HOMES.get(name, 'tasks')}"), name)
    unknown = AttributeError(f"module 'bra' has no attribute {name!r}")
    if not name.islower():  # as all modules are, so that none is looked for on the disk
        raise unknown
    try:
        return import_module(f"bra.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"bra.{name}":
            raise
        raise unknown from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
