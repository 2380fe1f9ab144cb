"""The multinomial channel in its minimal exponential form."""

import math
from collections.abc import Sequence
from numbers import Integral
from typing import Any, ClassVar, Literal

import torch
from gymnasium.spaces import Discrete, Space, Tuple
from torch import Tensor, nn

from bra.channels.base import Channel
from bra.channels.covering import check_logit, covering_logits
from bra.channels.distributions import Categorical
from bra.channels.spaces import Condition, feature_count, row_counts, row_number
from bra.checks.arrays import as_numbers


class Multinomial(Channel):
    """p_η(a|x) = exp(Σ_{i≠r} η_i^x a_i − Ψ(η^x)), Ψ(η) = log(1 + Σ_{i≠r} exp η_i).

    The action channel of Peng, Genewein, Leibfried & Braun (IROS 2017): `a` is one-hot and the
    reference outcome r has logit 0, so that there is one parameter per degree of freedom. It
    starts uniform, η = 0, unless told otherwise.

    Args:
        condition_space: `Discrete(m)`, or a `Tuple` of such, which has m pairs.
        outcome_space: `Discrete(n)`.
        reference: The outcome r.
        start: Initial η, shape (n − 1, m): a row per outcome other than r, a column per condition;
            or "covering", where the conditions share out the outcomes at random (see
            `bra.channels.covering`), those of the first part of a `Tuple`.
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If `reference` is no outcome, `start` is unknown, has another shape or is not
            finite, or `covering_logit` is negative or not finite.
    """

    zero: Tensor
    order: Tensor

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Tuple)
    outcome_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete,)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        reference: int = 0,
        start: Sequence[Sequence[float]] | Tensor | Literal["covering"] | None = None,
        covering_logit: float = 5.0,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        outcomes = feature_count(outcome_space)
        self.counts = row_counts(condition_space, type(self).__name__)
        conditions = math.prod(self.counts)
        check_logit(covering_logit)
        if not isinstance(reference, Integral) or not 0 <= reference < outcomes:
            raise ValueError(f"reference must be an outcome, 0 to {outcomes - 1}, got {reference}")
        rest = [outcome for outcome in range(outcomes) if outcome != reference]
        if isinstance(start, str) and start == "covering":
            logits = covering_logits(self.counts[0], outcomes, covering_logit)
            logits = logits.repeat_interleave(conditions // self.counts[0], 0).T
            eta = logits[rest] - logits[reference]
        elif start is None:
            eta = torch.zeros(outcomes - 1, conditions)
        else:
            eta = _as_eta(start, (outcomes - 1, conditions))
        self.reference: int = int(reference)
        self.eta: nn.Parameter = nn.Parameter(eta.clone())
        order = torch.tensor([reference, *rest]).argsort()
        self.register_buffer("zero", torch.zeros(1, conditions), persistent=False)
        self.register_buffer("order", order, persistent=False)

    def forward(self, condition: Condition) -> Categorical:
        """Returns p(outcome | condition), batch shape of `condition`."""
        return Categorical(logits=self._logits()[row_number(self.counts, condition)])

    def forward_all(self) -> Categorical:
        """All rows."""
        return Categorical(logits=self._logits())

    def _logits(self) -> Tensor:
        """A row per condition, (m, n)."""
        logits = torch.cat([self.zero, self.eta])
        if self.reference:
            logits = logits[self.order]
        return logits.T


def _as_eta(start: Sequence[Sequence[float]] | Tensor | str, shape: tuple[int, int]) -> Tensor:
    expected = f"start must be covering, or finite and of shape {shape} (outcomes − 1, conditions)"
    if isinstance(start, str):
        raise ValueError(f"{expected}, got {start!r}")
    eta = as_numbers(start, expected).to(torch.get_default_dtype())
    if eta.shape != shape or not eta.isfinite().all():
        raise ValueError(f"{expected}, got shape {tuple(eta.shape)}")
    return eta
