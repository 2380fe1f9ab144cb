"""What the agents of a population differ in."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from bra.budgets import check_budget
from bra.checks.memory import check_memory
from bra.checks.prices import check_beta, check_price_or_budget
from bra.checks.settings import check_seed
from bra.checks.words import amount

LEAST = 2**14
"""Bytes that an agent takes at least."""
Values = float | Sequence[float]
"""One number for all agents, or a list to vary."""


@dataclass(frozen=True)
class Setting:
    """Seed, prices or budgets, and learning rates of one agent.

    Attributes:
        seed: Of its initial channels and of all that its updates draw.
        beta_perception: β₁, per nat; where it follows a budget, as it stands.
        beta_action: β₂, per nat, likewise.
        perception_rate: Learning rate of the perception channel; None is the optimizer's own.
        action_rate: Learning rate of the action channel; None is the optimizer's own.
        perception_bits: The budget that β₁ follows; None if it follows none.
        action_bits: The budget that β₂ follows; None if it follows none.
    """

    seed: int
    beta_perception: float
    beta_action: float
    perception_rate: float | None
    action_rate: float | None
    perception_bits: float | None = None
    action_bits: float | None = None

    @property
    def prices(self) -> tuple[float, float]:
        """β₁ and β₂."""
        return self.beta_perception, self.beta_action

    @property
    def budgets(self) -> tuple[float | None, float | None]:
        """What the two prices follow, in bits."""
        return self.perception_bits, self.action_bits

    @property
    def given_prices(self) -> tuple[float | None, float | None]:
        """β₁ and β₂ where they follow no budget, else None."""
        first, second = (
            beta if budget is None else None
            for beta, budget in zip(self.prices, self.budgets, strict=True)
        )
        return first, second


def expand_settings(
    replicas: int,
    varied: Mapping[str, Values | None],
    grid: bool,
    free: bool,
    start: float,
    seed: int,
) -> tuple[Setting, ...]:
    """Every combination of the values with every seed; the seeds of a combination in a row.

    Args:
        replicas: Agents of each combination, of seeds `seed`, `seed` + 1, ….
        varied: What there is of a setting besides its seed, one or several values by name, or None:
            a price of None is 1, or follows the budget.
        grid: Whether to take all combinations of the lists; else they are walked through side by
            side.
        free: Whether what a percept tells of the action may be free, β₂ = ∞.
        start: β at which prices begin that follow budgets.
        seed: The first seed.

    Raises:
        ValueError: If a list is empty, a price, rate or budget is not positive and finite, a
            channel has a price and a budget, or lists that are walked through side by side differ
            in length.
    """
    lists = {name: _as_list(values, name, free) for name, values in varied.items()}
    if grid:
        rows = list(itertools.product(*lists.values()))
    else:
        lengths = {name: len(values) for name, values in lists.items() if len(values) != 1}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{name} has {length}" for name, length in lengths.items())
            raise ValueError(
                f"lists that are varied side by side must be of the same length, but {counts}; "
                "grid=true takes all combinations"
            )
        longest = max(map(len, lists.values()))
        full = (values * longest if len(values) == 1 else values for values in lists.values())
        rows = list(zip(*full, strict=True))
    check_memory(LEAST * replicas * len(rows), amount(replicas * len(rows), "agent"))
    seeds = range(check_seed(seed), seed + replicas)
    settings = [_with_prices(dict(zip(lists, row, strict=True)), start) for row in rows]
    return tuple(Setting(seed, **own) for own in settings for seed in seeds)


def _with_prices(own: dict[str, Any], start: float) -> dict[str, Any]:
    """With prices to begin with in the place of those that are None."""
    for channel in ("perception", "action"):
        beta, bits = own[f"beta_{channel}"], own[f"{channel}_bits"]
        check_price_or_budget(beta, bits, channel)
        if beta is None:
            own[f"beta_{channel}"] = 1.0 if bits is None else start
    return own


def _as_list(values: Values | None, name: str, free: bool) -> list[float | None]:
    if values is None:
        return [None]
    found: list[float | None] = [*values] if isinstance(values, Sequence) else [values]
    if not found:
        raise ValueError(f"{name} must hold at least one number, got an empty list")
    for value in found:
        if name.startswith("beta"):
            check_beta(value, name, infinite=free and name == "beta_action")  # type: ignore[arg-type]  # which it looks at
        elif name.endswith("_bits"):
            check_budget(value, name.removesuffix("_bits"))  # type: ignore[arg-type]
        elif value is not None and not (isinstance(value, Real) and 0 < value < math.inf):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    return found
