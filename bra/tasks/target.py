"""A continuous action that is to hit a target."""

from collections.abc import Sequence

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor

from bra.checks.arrays import Array
from bra.checks.tables import check_table
from bra.tasks.finite import FiniteStateTask, names_or_numbers, utility_table
from bra.tasks.observations import Code


class TargetTask(FiniteStateTask):
    """A continuous action that is to hit a target: U(ω, a) = −‖target(ω) − a‖².

    Args:
        targets: (W, d), the target of every world-state.
        prior: p(ω), (W,); uniform if None.
        observations: Sensor signals, see `observation_table`.
        state_names: A name per state; s0, s1, … if None.

    Raises:
        ValueError: If targets are no finite (W, d) table.
    """

    action_space: Box

    def __init__(
        self,
        targets: Array,
        prior: Array | None = None,
        observations: Code | Array = "onehot",
        state_names: Sequence[str] | None = None,
    ) -> None:
        self.targets = check_table(targets, "targets")
        states, dimensions = self.targets.shape
        super().__init__(prior, names_or_numbers(state_names, "s", states), observations)
        self.action_space = Box(-np.inf, np.inf, shape=(dimensions,), dtype=np.float32)

    def utility(self, state: Tensor, action: Tensor) -> Tensor:
        """−‖target(ω) − a‖²; see `Task.utility`."""
        targets = self.targets.to(action.device, action.dtype)
        return -(targets[state] - action).square().sum(-1)

    def grid(self, points: int) -> tuple[Tensor, Tensor] | None:
        """Actions between the targets, where the best ones are; None beyond three dimensions."""
        lows, highs = self.targets.amin(0).tolist(), self.targets.amax(0).tolist()
        if len(lows) > 3:
            return None
        ends = zip(lows, highs, strict=True)
        axes = [torch.linspace(*pair, points, dtype=torch.double) for pair in ends]
        actions = torch.cartesian_prod(*axes).reshape(-1, len(axes))
        return utility_table(self, torch.arange(len(self.prior)), actions), self.prior
