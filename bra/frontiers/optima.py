"""The best channels found at several pairs of prices, by what they earn and spend."""

from collections.abc import Callable
from typing import NamedTuple, Self

import torch
from torch import Tensor

from bra.blahut_arimoto import General, Serial

USED, SAME = 1e-6, 1e-3
"""p(x|ω) from which a state uses a percept; difference of p(a|x) up to which two are one."""
BETTER = 1e-9
"""Share of E[U] from which the channels of another price count as better."""


class Optima(NamedTuple):
    """Optima at N sets of prices, k of them each: two, or three where actions look again."""

    prices: Tensor  # β₁, β₂ and β₃, (k, N)
    bound: Tensor  # what J does not exceed, (N,)
    informations: Tensor  # I(Ω;X), I(X;A) and I(Ω;A|X), (k, N)
    expected_utility: Tensor  # (N,)
    end_to_end_information: Tensor  # (N,)
    percepts: Tensor  # those that are used and differ, (N,)

    @classmethod
    def of(cls, prices: Tensor, found: Serial, prior: Tensor) -> Self:
        """What there is to say of solutions at prices (k, N) of a task with prior p(ω), (W,)."""
        rates = [found.perception_information, found.action_information]
        if isinstance(found, General):
            rates.append(found.direct_information)
        return cls(
            prices=prices,
            bound=torch.as_tensor(found.tight_bound),
            informations=torch.stack([torch.as_tensor(rate) for rate in rates]),
            expected_utility=torch.as_tensor(found.expected_utility),
            end_to_end_information=torch.as_tensor(found.end_to_end_information),
            percepts=used_percepts(found, prior),
        )

    def costs(self) -> Tensor:
        """What the informations of all channels cost at all prices, (prices, channels)."""
        return (1 / self.prices).T @ self.informations

    @property
    def objective(self) -> Tensor:
        """J, (N,)."""
        return self.expected_utility - self.costs().diagonal()

    def take(self, index: Tensor) -> Self:
        """Some of them, in that order."""
        return type(self)(*(part[..., index] for part in self))

    def where(self, mask: Tensor, other: Self) -> Self:
        """These where a mask (N,) holds, else the others."""
        parts = zip(self, other, strict=True)
        return type(self)(*(torch.where(mask, mine, theirs) for mine, theirs in parts))

    def beside(self, *others: Self) -> Self:
        """All of them, ordered by prices, of each one."""
        every = type(self)(*(torch.cat(parts, -1) for parts in zip(self, *others, strict=True)))
        every = every.take(every.prices[0].argsort(stable=True))
        new = every.prices[0].diff(prepend=every.prices.new_zeros(1)) > 0
        return every.take(new.nonzero().flatten())

    def improved(self) -> Self:
        """The channels of another price in the place of those that they beat at their price."""
        best = (self.expected_utility - self.costs()).argmax(1)
        others = self.take(best)._replace(prices=self.prices, bound=self.bound)
        worth = others.objective > self.objective + BETTER * self.expected_utility.abs()
        return others.where(worth, self)

    def with_changes(self, solve: Callable[[Tensor], Self], close: float, most: int) -> Self:
        """With the optima on both sides of prices at which the number of percepts changes.

        Args:
            solve: Finds optima at prices (k, N).
            close: Ratio of the prices between which bisection leaves a change.
            most: Changes that are looked for, the first ones.
        """
        apart = self.prices[0, 1:] > close * self.prices[0, :-1]
        changed = (apart & (self.percepts[1:] != self.percepts[:-1])).nonzero().flatten()[:most]
        if not len(changed):
            return self
        low = below = self.take(changed)
        high = self.take(changed + 1)
        while (high.prices[0] / low.prices[0]).amax() > close:  # others may be inf
            middle = solve((low.prices * high.prices).sqrt())
            same = middle.percepts == below.percepts
            low, high = middle.where(same, low), high.where(same, middle)
        # There may be others above.
        return self.beside(low, high).with_changes(solve, close, most - len(changed))


def used_percepts(found: Serial, prior: Tensor) -> Tensor:
    """How many percepts some state uses, and differ in p(a|x), (N,), for N pairs of prices.

    However rare the state is: one that is possible counts.
    """
    used = found.percept_given_state[:, prior > 0].amax(1) > USED  # (N, X)
    rows = found.action_given_percept
    same = (rows[:, :, None] - rows[:, None]).abs().amax(-1) < SAME  # (N, X, X)
    earlier = torch.ones(same.shape[1:], dtype=torch.bool).tril(-1)
    return (used & ~(same & used[:, None] & earlier).any(-1)).sum(-1)
