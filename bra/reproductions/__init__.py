"""Published optima of bounded-rational decisions, worked out again."""

from bra.reproductions.problems import PROBLEMS, Problem, Value

__all__ = ["PROBLEMS", "Problem", "Value"]
