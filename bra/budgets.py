"""Prices that lead an agent to given rates of information."""

import math
from dataclasses import dataclass
from typing import Self

from bra.checks import check_price_or_budget, check_rate
from bra.tasks import FiniteTask, Task

PACE = 0.02
"""Most by which the logarithm of a price changes in an update."""
WIDEST = 1e4
"""Factor by which a price may get away from where it began."""


@dataclass(frozen=True)
class Budgets:
    """Budgets B of I(Ω;X) and I(X;A), which prices follow by a dual update.

    To maximise E[U] with I ≤ B is to maximise E[U] − λ (I − B) over the channels and to minimise it
    over λ = 1/β ≥ 0. The gradient in λ is B − I; here it moves the logarithm of β, in units of
    both: after every update

        log β ← log β + 0.02 (B − I) / (B + I),

    I being the information that the update saw. The price settles where I = B, or goes to 10⁴ times
    what it began with, and the information is as good as free, where more of it earns nothing.
    Where the rate jumps, no price has the rates between, and it goes back and forth.

    Attributes:
        limits: B of I(Ω;X) and of I(X;A) in nats; None for a channel that has a price.
        start: β to begin with.
    """

    limits: tuple[float | None, float | None]
    start: float

    @classmethod
    def of(
        cls,
        task: Task,
        betas: tuple[float | None, float | None],
        bits: tuple[float | None, float | None],
    ) -> Self | None:
        """Those of people, with information that is cheap to begin with; None if there are none.

        Raises:
            ValueError: If one is no number above 0, or there is a price, too.
        """
        limits = []
        for channel, beta, budget in zip(("perception", "action"), betas, bits, strict=True):
            check_price_or_budget(beta, budget, channel)
            if budget is not None and check_rate(budget, f"{channel}_bits") == 0:
                raise ValueError(f"{channel}_bits must be above 0, got 0; give a small price")
            limits.append(None if budget is None else budget * math.log(2))
        first, second = limits
        return None if bits == (None, None) else cls((first, second), _cheap(task))

    def follow(self, betas: tuple[float, ...], rates: list[float]) -> tuple[float, ...]:
        """β of both channels after an update at which they had these rates, nats."""
        pairs = zip(betas, rates, self.limits, strict=True)
        return tuple(b if limit is None else self._next(b, rate, limit) for b, rate, limit in pairs)

    def _next(self, beta: float, rate: float, limit: float) -> float:
        moved = beta * math.exp(PACE * (limit - rate) / (limit + rate))
        return min(max(moved, self.start / WIDEST), self.start * WIDEST)


def _cheap(task: Task) -> float:
    """A price at which information is cheap: by ten what it can earn, where that is known."""
    if not isinstance(task, FiniteTask):
        return 10.0
    worth = task.prior @ task.payoffs.amax(1) - (task.prior @ task.payoffs).amax()
    return 10 / (worth.item() or 1.0)
