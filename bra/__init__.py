"""Bounded-rational perception-action agents, trained and held against the certified optimum."""

from bra import blahut_arimoto, callbacks, channels, critics, tasks, update_rules
from bra.agent import Agent
from bra.channels import Channel
from bra.cooling import Cooling
from bra.objective import Objective
from bra.population.population import Population
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
    "tasks",
    "update_rules",
]
