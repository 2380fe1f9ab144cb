"""The agent: a perception and an action channel that learn together."""

from bra.agent.agent import Agent
from bra.agent.learner import Learner
from bra.agent.noise import leave_out_noise

__all__ = ["Agent", "Learner"]

leave_out_noise()
