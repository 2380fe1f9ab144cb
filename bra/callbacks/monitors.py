"""The monitors that the command adds to a run."""

import lightning.pytorch as pl

from bra.callbacks.baseline import BaselineMonitor
from bra.callbacks.behaviour import BehaviourFigures
from bra.callbacks.frames import ObservationFrames
from bra.callbacks.information import InformationMonitor
from bra.callbacks.population import PopulationMonitor
from bra.callbacks.progress import UpdateBar
from bra.callbacks.rollouts import RolloutWriter
from bra.callbacks.summary import RunSummary

MONITORS: dict[str, type[pl.Callback]] = {
    "information": InformationMonitor,
    "baseline": BaselineMonitor,
    "population": PopulationMonitor,
    "behaviour": BehaviourFigures,
    "frames": ObservationFrames,
    "summary": RunSummary,
    "rollouts": RolloutWriter,
}


def monitors() -> list[pl.Callback]:
    """All of them with their defaults, and the progress bar, for a trainer's `callbacks`."""
    return [*(monitor() for monitor in MONITORS.values()), UpdateBar()]
