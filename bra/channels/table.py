"""A categorical table as a channel."""

from typing import Any, ClassVar, Literal

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor, nn

from bra.channels.base import Channel
from bra.channels.covering import covering_logits
from bra.channels.distributions import Categorical
from bra.channels.spaces import feature_count


class Table(Channel):
    """p(y|c) = softmax(logits[c])_y: one free categorical distribution per condition.

    The logits start as independent normals, since equal rows are a saddle point of J at which no
    percept means anything.

    Args:
        condition_space: `Discrete`.
        outcome_space: `Discrete`.
        spread: Standard deviation of the initial logits.
        start: None, or "covering", where besides the conditions share out the outcomes at random
            (see `bra.channels.covering`).
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If `spread` or `covering_logit` is negative or not finite, or `start` unknown.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete,)
    outcome_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete,)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        spread: float = 1.0,
        start: Literal["covering"] | None = None,
        covering_logit: float = 5.0,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        if not 0 <= spread < float("inf"):
            raise ValueError(f"spread must be finite and at least 0, got {spread}")
        if start not in (None, "covering"):
            raise ValueError(f"start must be covering or None, got {start!r}")
        shape = (feature_count(condition_space), feature_count(outcome_space))
        logits = spread * torch.randn(shape)
        if start == "covering":
            logits += covering_logits(*shape, covering_logit)
        self.logits = nn.Parameter(logits)

    def forward(self, condition: Tensor) -> Categorical:
        """Returns p(outcome | condition), batch shape of `condition`."""
        return Categorical(logits=self.logits[condition])

    def forward_all(self) -> Categorical:
        """All rows."""
        return Categorical(logits=self.logits)
