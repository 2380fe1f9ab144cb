"""The agent: a perception and an action channel that learn together."""

from bra.agent.agent import Agent
from bra.agent.learner import Learner

__all__ = ["Agent", "Learner"]
