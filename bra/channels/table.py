"""A categorical table as a channel."""

import math
from typing import Any, ClassVar, Literal

import torch
from gymnasium.spaces import Discrete, Space, Tuple
from torch import nn

from bra.channels.base import Channel
from bra.channels.covering import check_logit, covering_logits
from bra.channels.distributions import Categorical
from bra.channels.spaces import Condition, feature_count, row_counts, row_number
from bra.checks.settings import check_real


class Table(Channel):
    """p(y|c) = softmax(logits[c])_y: one free categorical distribution per condition.

    The logits start as independent normals, since equal rows are a saddle point of J at which no
    percept means anything.

    Args:
        condition_space: `Discrete`, or a `Tuple` of such.
        outcome_space: `Discrete`.
        spread: Standard deviation of the initial logits.
        start: None, or "covering", where besides the conditions share out the outcomes at random
            (see `bra.channels.covering`), those of the first part of a `Tuple`.
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If `spread` or `covering_logit` is negative or not finite, or `start` unknown.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Tuple)
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
        check_real(spread, "spread", "finite and at least 0", lambda spread: spread >= 0)
        check_logit(covering_logit)
        if start not in (None, "covering"):
            raise ValueError(f"start must be covering or None, got {start!r}")
        self.counts = row_counts(condition_space, type(self).__name__)
        shape = (math.prod(self.counts), feature_count(outcome_space))
        logits = spread * torch.randn(shape)
        if start == "covering":
            cover = covering_logits(self.counts[0], shape[1], covering_logit)
            logits += cover.repeat_interleave(shape[0] // self.counts[0], 0)
        self.logits = nn.Parameter(logits)

    def forward(self, condition: Condition) -> Categorical:
        """Returns p(outcome | condition), batch shape of `condition`."""
        return Categorical(logits=self.logits[row_number(self.counts, condition)])

    def forward_all(self) -> Categorical:
        """All rows."""
        return Categorical(logits=self.logits)
