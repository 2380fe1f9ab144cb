"""Prices of information that start low and rise to what the agent is to pay."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Self

import torch
from torch import Tensor

from bra.checkpoints.recipes import Rebuildable
from bra.checks.settings import check_length, in_updates
from bra.randomness.generators import counted_generator

Factor = float | Sequence[float]
"""A number, or the two ends of a range from which every agent draws its own."""


@dataclass(frozen=True)
class Cooling(Rebuildable):
    """β₁ and β₂ times scales that approach 1 geometrically.

    The scale of update k is factor^(1 − k/updates), and 1 from k = `updates` on. While information
    is cheap, percepts and actions become distinct; dear information then merges those that do not
    pay. It depends on the number of updates, and for ranges on the agent's seed, alone, and touches
    training only: agents are always evaluated at their own prices.

    Which optimum is reached depends more on the way of the prices than on anything that is drawn
    at random. With a range, agents of different seeds go different ways; one that reaches down to
    less than 1 makes information dear first for some of them.

    Args:
        factor: Scale of β₁ in the first update; less than 1 makes information dear first. A pair
            of numbers is a range: every agent draws its own factor from it, log-uniformly.
        updates: Updates until the scales are 1, or, less than 1, their share of the run, which is
            turned into updates when the run begins.
        action_factor: The same for β₂; None is the agent's `factor`.

    Raises:
        ValueError: If a factor is not positive and finite, a range is not two of them in rising
            order, or `updates` is neither a whole number nor a share.
    """

    factor: Factor = 4.0
    updates: int | float = 0.4
    action_factor: Factor | None = None

    def __post_init__(self) -> None:
        for name in ("factor", "action_factor"):
            factor = getattr(self, name)
            if factor is not None or name == "factor":
                object.__setattr__(self, name, _check_factor(factor, f"cooling {name}"))
        check_length(self.updates, "cooling updates")

    def settled(self, run: int) -> Self:
        """The same in a run of so many updates."""
        return type(self)(**(self.given_arguments() | {"updates": in_updates(self.updates, run)}))

    def factors(self, seed: int) -> tuple[float, float]:
        """Factors of β₁ and β₂ of the agent of a seed."""
        number = torch.rand(2, generator=counted_generator(seed, 0, "cooling"), dtype=torch.double)
        along_1, along_2 = number.tolist()
        first = _within(self.factor, along_1)
        return first, first if self.action_factor is None else _within(self.action_factor, along_2)

    @property
    def length(self) -> int:
        """Updates until the scales are 1."""
        return in_updates(self.updates)

    def exponent(self, update: int) -> float:
        """Power of the factors in `update`, counted from 0: falls from 1 to 0."""
        return max(0.0, 1 - update / self.length)

    def scales(self, update: int, seed: int) -> tuple[float, float]:
        """What β₁ and β₂ are multiplied by in `update`, counted from 0."""
        exponent = self.exponent(update)
        factor, action_factor = self.factors(seed)
        return factor**exponent, action_factor**exponent

    def along(self, own: Tensor, updates: Sequence[int], seeds: Sequence[int]) -> Tensor:
        """What the agents of some seeds pay in some updates, (n, k, R).

        Args:
            own: β₁, β₂ and, where there is one, β₃, which cools with β₂, (k, R), float64.
            updates: Numbers of n updates.
            seeds: Of the R agents.
        """
        first, second = zip(*map(self.factors, seeds), strict=True)
        factors = torch.tensor([first, second, second][: len(own)], dtype=own.dtype)
        exponents = torch.tensor([*map(self.exponent, updates)], dtype=own.dtype)
        return own * factors ** exponents.reshape(-1, 1, 1)


def _within(factor: Factor, along: float) -> float:
    """A factor, or a point of a range on a logarithmic scale, from 0 at its low end to 1."""
    if not isinstance(factor, Sequence):
        return factor
    low, high = factor
    return float(low * (high / low) ** along)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_factor(factor: Factor, name: str) -> Factor:
    ends = tuple(factor) if isinstance(factor, Sequence) else (factor,)
    if not all(_is_number(end) and 0 < end < math.inf for end in ends):
        raise ValueError(f"{name} must be positive and finite, got {factor!r}")
    if not isinstance(factor, Sequence):
        return factor
    if len(ends) != 2 or ends[0] > ends[1]:
        raise ValueError(
            f"{name} must be a number, or the low and the high end of a range, got {factor!r}"
        )
    return ends
