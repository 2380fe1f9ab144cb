"""The multinomial channel in its minimal exponential form."""

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor, nn
from torch.distributions import Categorical

from bra.channels.base import Channel
from bra.channels.spaces import feature_count


class Multinomial(Channel):
    """p_η(a|x) = exp(Σ_{i≠r} η_i^x a_i − Ψ(η^x)), Ψ(η) = log(1 + Σ_{i≠r} exp η_i).

    The action channel of Peng, Genewein, Leibfried & Braun (IROS 2017): `a` is one-hot and the
    reference outcome r has logit 0, so that there is one parameter per degree of freedom. It
    starts uniform, η = 0, unless told otherwise.

    Args:
        condition_space: `Discrete(m)`.
        outcome_space: `Discrete(n)`.
        reference: The outcome r.
        start: Initial η, shape (n − 1, m): a row per outcome other than r, a column per condition.

    Raises:
        ValueError: If `reference` is no outcome, or `start` has another shape or is not finite.
    """

    zero: Tensor
    order: Tensor

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete,)
    outcome_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete,)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        reference: int = 0,
        start: Sequence[Sequence[float]] | Tensor | None = None,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        shape = (feature_count(outcome_space) - 1, feature_count(condition_space))
        if not 0 <= reference <= shape[0]:
            raise ValueError(f"reference must be an outcome, 0 to {shape[0]}, got {reference}")
        eta = (
            torch.zeros(shape)
            if start is None
            else torch.as_tensor(start).to(torch.get_default_dtype())
        )
        if eta.shape != shape or not eta.isfinite().all():
            raise ValueError(
                f"start must be finite and of shape {shape} (outcomes − 1, conditions), "
                f"got shape {tuple(eta.shape)}"
            )
        self.reference = reference
        self.eta = nn.Parameter(eta.clone())
        rest = range(1, shape[0] + 1)
        order = torch.tensor([*rest[:reference], 0, *rest[reference:]])
        self.register_buffer("zero", torch.zeros(1, shape[1]), persistent=False)
        self.register_buffer("order", order, persistent=False)

    def forward(self, condition: Tensor) -> Categorical:
        """Returns p(outcome | condition), batch shape of `condition`."""
        logits = torch.cat([self.zero, self.eta])
        if self.reference:
            logits = logits[self.order]
        return Categorical(logits=logits.T[condition], validate_args=False)
