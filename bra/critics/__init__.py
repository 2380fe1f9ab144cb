"""Critics: utilities of all actions, learnt from the actions that were taken."""

from bra.critics.base import Critic
from bra.critics.exploration import Exploration
from bra.critics.network import NetworkCritic
from bra.critics.posterior import StatePosterior
from bra.critics.table import TableCritic

__all__ = ["Critic", "Exploration", "NetworkCritic", "StatePosterior", "TableCritic"]
