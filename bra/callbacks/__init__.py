"""Callbacks that watch an agent and never change its training."""

from bra.callbacks.baseline import BaselineMonitor
from bra.callbacks.behaviour import BehaviourFigures
from bra.callbacks.checkpoints import RunCheckpoints
from bra.callbacks.frames import ObservationFrames
from bra.callbacks.information import InformationMonitor
from bra.callbacks.monitors import monitors
from bra.callbacks.population import PopulationMonitor
from bra.callbacks.progress import UpdateBar
from bra.callbacks.rollouts import RolloutWriter
from bra.callbacks.summary import RunSummary

__all__ = [
    "BaselineMonitor",
    "BehaviourFigures",
    "InformationMonitor",
    "ObservationFrames",
    "PopulationMonitor",
    "RolloutWriter",
    "RunCheckpoints",
    "RunSummary",
    "UpdateBar",
    "monitors",
]
