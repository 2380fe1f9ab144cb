"""A running mean per signal and action."""

import torch
from gymnasium.spaces import Discrete
from torch import Tensor

from bra.checks.settings import check_real
from bra.critics.base import Critic
from bra.randomness.draws import UniformNumbers
from bra.tasks import Task, knows_signals


class TableCritic(Critic):
    """Û(ξ, a) = mean of the utilities received for a at ξ; `start` where there were none.

    For finitely many signals: a `Discrete` observation space, or a task with known states. With
    the best utility that can be hoped for as start, what was never tried looks good and is tried;
    no other exploration is needed.

    Args:
        start: Û of an action that was never taken.

    Raises:
        ValueError: If `start` is not finite.
    """

    signals: Tensor
    total: Tensor
    count: Tensor

    def __init__(self, start: float) -> None:
        super().__init__()
        self.start = check_real(start, "start", "finite")
        self.register_buffer("signals", torch.zeros(0), persistent=False)
        self.register_buffer("total", torch.zeros(0, 0, dtype=torch.double))
        self.register_buffer("count", torch.zeros(0, 0, dtype=torch.double))

    def make_room(self, task: Task, actions: int) -> None:
        """A row per signal, a column per action."""
        if isinstance(task.observation_space, Discrete):
            self.signals = torch.arange(int(task.observation_space.n))
        elif knows_signals(task):
            self.signals = task.states().observation
        else:
            raise ValueError(
                f"TableCritic needs finitely many signals, got {task.observation_space} of "
                f"{type(task).__name__}; use NetworkCritic"
            )
        self.total = torch.zeros(len(self.signals), actions, dtype=torch.double)
        self.count = torch.zeros(len(self.signals), actions, dtype=torch.double)

    def forward(self, observation: Tensor) -> Tensor:
        """Û(ξ, a) of all actions, (B, A), float64."""
        mean = self.total / self.count.clamp_min(1)
        return torch.where(self.count > 0, mean, self.start)[self._row(observation)]

    def learn(
        self, observation: Tensor, action: Tensor, utility: Tensor, uniform: UniformNumbers
    ) -> None:
        """Takes utilities into the means."""
        rows, columns = (torch.arange(n, device=action.device) for n in self.count.shape)
        row = (self._row(observation).unsqueeze(-1) == rows).to(utility.dtype)
        column = (action.unsqueeze(-1) == columns).to(utility.dtype)
        self.count += row.T @ column
        self.total += (row * utility.unsqueeze(-1)).T @ column

    def _row(self, observation: Tensor) -> Tensor:
        """The first row whose signal equals ξ, (B,)."""
        if self.signals.ndim == 1:
            return observation
        same = observation.flatten(1).unsqueeze(1) == self.signals.flatten(1)
        return same.all(-1).to(torch.uint8).argmax(-1)
