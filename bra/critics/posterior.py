"""What a noisy signal says of the state."""

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from bra.critics.fitted import FittedNetwork
from bra.tasks import FiniteStateTask

HIDDEN, RATE = (64,), 0.003
TRUST = 150
"""Steps after which the network is trusted."""


class StatePosterior(nn.Module):
    """q(ω|ξ) of a task with known states and a noisy sensor, learnt from pairs that it draws.

    A network, fitted by cross-entropy to the state behind each signal. What an action may be
    expected to bring at a signal is then E[U(ω,a)|ξ] = Σ_ω q(ω|ξ) U(ω,a), in whatever unit.

    Args:
        task: Draws the pairs.
    """

    def __init__(self, task: FiniteStateTask) -> None:
        super().__init__()
        self.count = len(task.prior)
        self.network = FittedNetwork(task.observation_space, HIDDEN, self.count, RATE)

    def forward(self, observation: Tensor) -> Tensor:
        """q(ω|ξ), (B, W), float64."""
        found: Tensor = self.network(observation).double().softmax(-1)
        return found

    def learn(self, observation: Tensor, state: Tensor) -> Tensor:
        """Learns from signals (B, …) and their states (B,).

        Returns:
            q(ω|ξ) before that, (B, W); mixed, in the first `TRUST` steps ever less, with the
            states themselves: a network that knows nothing yet says the same of all signals, and
            channels that are fitted to it would do so too.
        """
        known = (state.unsqueeze(-1) == torch.arange(self.count, device=state.device)).double()
        trust = (self.network.made / TRUST).clamp(max=1.0).double()
        found: Tensor = trust * self(observation) + (1 - trust) * known
        self.network.step(observation, lambda logits: cross_entropy(logits, state))
        return found
