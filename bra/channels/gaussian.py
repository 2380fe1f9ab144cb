"""A normal distribution per condition as a channel."""

import math
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from torch import nn
from torch.distributions import Distribution

from bra.channels.base import Channel
from bra.channels.spaces import MINIMUM_SCALE, Condition, gaussian, row_counts, row_number
from bra.checks.settings import check_real


class Gaussian(Channel):
    """p(y|c) = N(y; μ_c, s_c²) with s_c = 10⁻³ + exp(log_scale_c), independent dimensions.

    Reparameterised (`rsample`); scales are bounded below, so that densities stay finite. Means
    start as standard normals, since equal rows are a saddle point of J. Samples are not clipped
    to the bounds of the outcome space.

    Args:
        condition_space: `Discrete`, or a `Tuple` of such.
        outcome_space: `Box` of any shape.
        scale: Initial standard deviation, more than 10⁻³.

    Raises:
        ValueError: If `scale` is not finite or not more than 10⁻³.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Tuple)
    outcome_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Box,)

    def __init__(
        self, condition_space: Space[Any], outcome_space: Space[Any], scale: float = 1.0
    ) -> None:
        super().__init__(condition_space, outcome_space)
        expected = f"finite and more than {MINIMUM_SCALE}"
        check_real(scale, "scale", expected, lambda scale: scale > MINIMUM_SCALE)
        self.counts = row_counts(condition_space, type(self).__name__)
        shape = (math.prod(self.counts), *(outcome_space.shape or ()))
        self.mean = nn.Parameter(torch.randn(shape))
        self.log_scale = nn.Parameter(torch.full(shape, scale - MINIMUM_SCALE).log())

    def forward(self, condition: Condition) -> Distribution:
        """Returns p(outcome | condition), batch shape of `condition`."""
        event_dims, row = self.mean.ndim - 1, row_number(self.counts, condition)
        return gaussian(self.mean[row], self.log_scale[row], event_dims)
