"""Many updates in one call of compiled code."""

from bra.blocks.blocks import Blocks, Many
from bra.blocks.traces import Untraceable

__all__ = ["Blocks", "Many", "Untraceable"]
