"""Rate–utility curves of the chain Ω → X → A: what more information would earn."""

from bra.frontiers.frontier import Frontier, frontier

__all__ = ["Frontier", "frontier"]
