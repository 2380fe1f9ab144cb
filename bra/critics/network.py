"""A network that values all actions."""

from collections.abc import Sequence

import torch
from torch import Tensor

from bra.checks.settings import check_count, check_real, check_sizes
from bra.critics.base import Critic
from bra.critics.fitted import FittedNetwork
from bra.critics.replay import Replay
from bra.randomness.draws import UniformNumbers
from bra.tasks import Task


class NetworkCritic(Critic):
    """Û(ξ, ·) from a fully connected network, fitted to remembered triplets by squared error.

    Every update remembers its encounters and makes `steps` steps of Adam (Kingma & Ba, ICLR 2015)
    on `batch_size` remembered triplets each; the channels, too, are fitted on `batch_size`
    remembered signals. Actions that have become rare are so not forgotten, and one encounter per
    update is enough. The network's outputs count from `start`, in units of how far utilities were
    from it at most, so that it learns alike whatever utilities are measured in.

    Args:
        hidden: Sizes of the hidden layers, with rectified linear units.
        start: Where Û starts; half of the best utility serves well. None is what the first
            encounters bring.
        memory: Triplets remembered.
        batch_size: Triplets per step.
        steps: Steps per update.
        lr: Learning rate.

    Raises:
        ValueError: If a number is not positive, or `start` not finite.
    """

    network: FittedNetwork
    origin: Tensor
    reach: Tensor

    def __init__(
        self,
        hidden: Sequence[int] = (64,),
        start: float | None = None,
        memory: int = 4096,
        batch_size: int = 32,
        steps: int = 1,
        lr: float = 0.003,
    ) -> None:
        super().__init__()
        self.hidden = check_sizes(hidden, "hidden sizes")
        self.start = None if start is None else check_real(start, "start", "finite")
        self.lr = check_real(lr, "lr", "positive and finite", lambda lr: lr > 0)
        self.batch_size = check_count(batch_size, "batch_size")
        self.steps = check_count(steps, "steps")
        self.replay = Replay(memory)
        self.register_buffer("origin", torch.tensor(start or 0.0, dtype=torch.double))
        self.register_buffer("reach", torch.zeros((), dtype=torch.double))

    def make_room(self, task: Task, actions: int) -> None:
        """The network and the memory."""
        self.network = FittedNetwork(task.observation_space, self.hidden, actions, self.lr)
        self.replay.make_room(task.observation_space)

    def forward(self, observation: Tensor) -> Tensor:
        """Û(ξ, a) of all actions, (B, A), float64."""
        value: Tensor = self.network(observation).double()
        return self.origin + self._unit() * value

    def take(
        self,
        observation: Tensor,
        action: Tensor,
        utility: Tensor,
        uniform: UniformNumbers = torch.rand,
    ) -> None:
        """Notes where utilities are and how far they reach, and goes on; see `Critic.take`."""
        if self.start is None:
            first = self.replay.written == 0
            self.origin.copy_(torch.where(first, utility.mean(), self.origin))
        farthest = (utility - self.origin).abs().amax()
        self.reach.copy_(torch.maximum(self.reach, farthest))
        super().take(observation, action, utility, uniform)

    def learn(
        self, observation: Tensor, action: Tensor, utility: Tensor, uniform: UniformNumbers
    ) -> None:
        """Remembers the encounters and makes the steps."""
        self.replay.add(observation, action, utility - self.origin)
        for _ in range(self.steps):
            self._step(*self.replay.draw(self.batch_size, uniform))

    def _step(self, observation: Tensor, action: Tensor, difference: Tensor) -> None:
        due = difference / self._unit()

        def loss(value: Tensor) -> Tensor:
            promised = value.gather(-1, action.unsqueeze(-1)).squeeze(-1)
            return (promised - due.to(value)).square().mean()

        self.network.step(observation, loss)

    def recall(self, observation: Tensor, uniform: UniformNumbers) -> Tensor:
        """Remembered signals."""
        return self.replay.draw(self.batch_size, uniform)[0]

    def _unit(self) -> Tensor:
        """What the network's outputs are multiples of, ()."""
        return torch.where(self.reach > 0, self.reach, 1.0)
