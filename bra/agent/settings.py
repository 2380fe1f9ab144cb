"""What the agents of a population differ in."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

from bra.checkpoints.files import VARIED
from bra.checks import check_beta, check_seed
from bra.memory import check_memory
from bra.words import amount

LEAST = 2**14
"""Bytes that an agent takes at least."""
Values = float | Sequence[float]
"""One number for all agents, or a list to vary."""


@dataclass(frozen=True)
class Setting:
    """Seed, prices and learning rates of one agent.

    Attributes:
        seed: Of its initial channels and of all that its updates draw.
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        perception_rate: Learning rate of the perception channel; None is the optimizer's own.
        action_rate: Learning rate of the action channel; None is the optimizer's own.
    """

    seed: int
    beta_perception: float
    beta_action: float
    perception_rate: float | None
    action_rate: float | None

    @property
    def prices(self) -> tuple[float, float]:
        """β₁ and β₂."""
        return self.beta_perception, self.beta_action


def expand_settings(
    replicas: int,
    beta_perception: Values,
    beta_action: Values,
    perception_rate: Values | None,
    action_rate: Values | None,
    grid: bool,
    free: bool,
    seed: int,
) -> tuple[Setting, ...]:
    """Every combination of the values with every seed; the seeds of a combination in a row.

    Args:
        replicas: Agents of each combination, of seeds `seed`, `seed` + 1, ….
        beta_perception: β₁, one or several.
        beta_action: β₂, one or several.
        perception_rate: Learning rates, one or several, or None.
        action_rate: Learning rates, one or several, or None.
        grid: Whether to take all combinations of the lists; else they are walked through side by
            side.
        free: Whether what a percept tells of the action may be free, β₂ = ∞.
        seed: The first seed.

    Raises:
        ValueError: If a list is empty, a price or rate is not positive and finite, or lists that
            are walked through side by side differ in length.
    """
    columns = dict(
        zip(VARIED, (beta_perception, beta_action, perception_rate, action_rate), strict=True)
    )
    lists = {name: _as_list(values, name, free) for name, values in columns.items()}
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
    return tuple(Setting(seed, *row) for row in rows for seed in seeds)  # type: ignore[arg-type]  # prices are never None


def _as_list(values: Values | None, name: str, free: bool) -> list[float | None]:
    found: list[float | None] = [*values] if isinstance(values, Sequence) else [values]
    if not found:
        raise ValueError(f"{name} must hold at least one number, got an empty list")
    for value in found:
        if name.startswith("beta"):
            check_beta(value, name, infinite=free and name == "beta_action")  # type: ignore[arg-type]  # which it looks at
        elif value is not None and not (isinstance(value, Real) and 0 < value < math.inf):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    return found
