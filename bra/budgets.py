"""Prices that lead agents to given rates of information."""

import math
from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor, nn

from bra.checks.prices import check_price_or_budget, check_rate
from bra.tasks import FiniteTask, Task

PACE = 0.02
"""Most by which the logarithm of a price changes in an update."""
WIDEST = 1e4
"""Factor by which a price may get away from where it began."""

Pair = tuple[float | None, float | None]


class Budgets(nn.Module):
    """Budgets B of I(Ω;X) and I(X;A), which prices follow by a dual update.

    To maximise E[U] with I ≤ B is to maximise E[U] − λ (I − B) over the channels and to minimise it
    over λ = 1/β ≥ 0. The gradient in λ is B − I; here it moves the logarithm of β, in units of
    both: after every update

        log β ← log β + 0.02 (B − I) / (B + I),

    I being the information that the update saw. The price settles where I = B, or goes to 10⁴ times
    what it began with, and the information is as good as free, where more of it earns nothing.
    Where the rate jumps, no price has the rates between, and it goes back and forth.

    Where prices stand is part of checkpoints. In a population all tensors have R in front of their
    shapes, and every agent's prices follow its own budgets.

    Args:
        bits: B of I(Ω;X) and of I(X;A) in bits; None for a channel that has a price.
        start: β to begin with.

    Attributes:
        limits: The same in nats.
        moved: By how much log β of each channel has moved, (2,), float64.
        begins: The first update, counted from 0, after which prices move, ().
    """

    most: Tensor
    begins: Tensor
    moved: Tensor

    def __init__(self, bits: Pair, start: float) -> None:
        super().__init__()
        self.bits, self.start = bits, start
        first, second = (None if budget is None else budget * math.log(2) for budget in bits)
        self.limits = first, second
        unlimited = [math.inf if limit is None else limit for limit in self.limits]
        most = torch.tensor(unlimited, dtype=torch.double)
        self.register_buffer("most", most, persistent=False)
        self.register_buffer("begins", torch.tensor(0), persistent=False)
        self.register_buffer("moved", torch.zeros(2, dtype=torch.double))

    @classmethod
    def of(cls, task: Task, betas: Pair, bits: Pair) -> Self | None:
        """Those of people, with information that is cheap to begin with; None if there are none.

        Raises:
            ValueError: If one is no number above 0, or there is a price, too.
        """
        for channel, beta, budget in zip(("perception", "action"), betas, bits, strict=True):
            check_price_or_budget(beta, budget, channel)
            if budget is not None:
                check_budget(budget, channel)
        return None if bits == (None, None) else cls(bits, cheap(task))

    @property
    def factors(self) -> Tensor:
        """What prices are multiplied by to follow the budgets, (2,); 1 for those that stand."""
        return torch.where(self.most.isfinite(), self.moved.exp(), 1.0)

    def lead(self, betas: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """β₁, β₂ and, if there is one, β₃ as they follow the budgets, from those that do not."""
        factors = self.factors.unbind(-1)
        led = (beta * factor.to(beta) for beta, factor in zip(betas, factors, strict=False))
        return *led, *betas[2:]

    def follow(self, rates: Sequence[Tensor], update: int | Tensor) -> None:
        """Moves prices after an update that has seen these rates, nats, of an agent or of all."""
        seen = torch.stack([*rates], -1).detach().to(self.moved)
        step = PACE * (self.most - seen) / (self.most + seen)
        widest = math.log(WIDEST)
        moved = (self.moved + step).clamp(-widest, widest)
        moves = self.most.isfinite() & (self.begins <= update)
        self.moved.copy_(torch.where(moves, moved, self.moved))


def check_budget(bits: float, channel: str) -> None:
    """Looks at a budget in bits.

    Raises:
        ValueError: If it is no number above 0.
    """
    if check_rate(bits, f"{channel}_bits") == 0:
        raise ValueError(f"{channel}_bits must be above 0, got 0; give a small price")


def cheap(task: Task) -> float:
    """A price at which information is cheap: by ten what it can earn, where that is known."""
    if not isinstance(task, FiniteTask):
        return 10.0
    worth = task.prior @ task.payoffs.amax(1) - (task.prior @ task.payoffs).amax()
    return 10 / (worth.item() or 1.0)
