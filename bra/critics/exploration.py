"""Actions that are taken for the critic's sake."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from bra.checkpoints.recipes import Rebuildable
from bra.checks.settings import check_length, check_real, in_updates


@dataclass(frozen=True)
class Exploration(Rebuildable):
    """A share of uniform actions: all at first, while the channels wait, then ever fewer.

    In the first `uniform_updates` updates every action is uniform and only the critic learns. From
    there on, the probability that an action is uniform falls linearly with the number k of
    updates, share · (1 − k/updates), and is 0 from k = `updates` on. It depends on the number of
    updates alone. Lengths less than 1 are shares of the run, which are turned into updates when it
    begins.

    Args:
        share: Where the line begins, between 0 and 1.
        updates: Where it ends.
        uniform_updates: Length of the first phase.

    Raises:
        ValueError: If `share` is outside, or a length neither a whole number nor a share.
    """

    share: float = 0.3
    updates: int | float = 1000
    uniform_updates: int | float = 0

    def __post_init__(self) -> None:
        name, expected = "exploration share", "between 0 and 1"
        check_real(self.share, name, expected, lambda share: 0 <= share <= 1)
        check_length(self.updates, "exploration updates")
        if self.uniform_updates != 0:
            check_length(self.uniform_updates, "exploration uniform_updates")

    def settled(self, run: int) -> Self:
        """The same in a run of so many updates."""
        lengths = {n: in_updates(getattr(self, n), run) for n in ("updates", "uniform_updates")}
        return type(self)(**(self.given_arguments() | lengths))

    def probability(self, update: int | Tensor) -> Tensor:
        """Probability that an action of `update`, counted from 0, is uniform, shape ()."""
        number = torch.as_tensor(update)
        falling = self.share * (1 - number / in_updates(self.updates)).clamp_min(0.0)
        return torch.where(number < in_updates(self.uniform_updates), 1.0, falling)
