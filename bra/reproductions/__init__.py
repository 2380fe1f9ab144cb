"""Published optima of bounded-rational decisions, worked out again, and published training."""

from bra.reproductions.experiments import EXPERIMENTS, Experiment
from bra.reproductions.problems import PROBLEMS, Problem, Value

__all__ = ["EXPERIMENTS", "PROBLEMS", "Experiment", "Problem", "Value"]
