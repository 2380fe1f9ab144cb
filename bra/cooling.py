"""Prices of information that start low and rise to what the agent is to pay."""

import math
from dataclasses import dataclass

from bra.checks import check_count
from bra.recipes import Rebuildable


@dataclass(frozen=True)
class Cooling(Rebuildable):
    """β₁ and β₂ times a scale that falls geometrically, from `factor` to 1.

    The scale of update k is factor^(1 − k/updates), and 1 from k = `updates` on. While information
    is cheap, percepts and actions become distinct; dear information then merges those that do not
    pay. It depends on the number of updates alone and touches training only: agents are always
    evaluated at their own prices.

    Args:
        factor: Scale of the first update. A factor of less than 1 makes information dear first.
        updates: Updates until the scale is 1.

    Raises:
        ValueError: If `factor` is not positive and finite, or `updates` less than 1.
    """

    factor: float = 4.0
    updates: int = 1000

    def __post_init__(self) -> None:
        if isinstance(self.factor, bool) or not 0 < self.factor < math.inf:
            raise ValueError(f"cooling factor must be positive and finite, got {self.factor!r}")
        check_count(self.updates, "cooling updates")

    def scale(self, update: int) -> float:
        """What both β are multiplied by in `update`, counted from 0."""
        return float(self.factor ** max(0.0, 1 - update / self.updates))
