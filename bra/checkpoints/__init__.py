"""What a checkpoint holds, and how an agent is rebuilt from it."""

from bra.checkpoints.recipes import Rebuildable

__all__ = ["Rebuildable"]
