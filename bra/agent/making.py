"""Channels as agents make them, and what looking again asks of other parts."""

from typing import Any

import torch
from gymnasium.spaces import Discrete, Space

from bra.agent.defaults import ChannelFactory
from bra.agent.optimizers import check_factory
from bra.channels import Channel
from bra.channels.base import check_channel
from bra.checks.memory import TooLarge, missing_memory
from bra.randomness.generators import counted
from bra.update_rules import UpdateRule


def make_channel(
    name: str, factory: ChannelFactory, condition: Space[Any], outcome: Space[Any], seed: int
) -> Channel:
    """A channel from its factory, with random numbers of its own.

    Args:
        name: "perception" or "action", which errors begin with.
        factory: Makes it from both spaces.
        condition: What it is given.
        outcome: What it decides on.
        seed: Of the agent.

    Raises:
        TypeError: If the factory makes something other than a channel, or its forward returns no
            distribution.
        ValueError: If it does not take the spaces.
        TooLarge: If no memory holds it.
    """
    check_factory(factory, name, Channel)
    with counted(seed, 0, name, torch.device("cpu")):
        try:
            channel = factory(condition, outcome)
            check_channel(channel)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name}: {error}") from error
        except (RuntimeError, MemoryError) as error:
            if not (line := missing_memory(error)):
                raise
            raise TooLarge(f"{name}: no memory holds this channel: {line}") from error
    return channel


def check_looks(percept_space: Space[Any], rule: UpdateRule) -> None:
    """Looks whether actions can look at the signal again.

    Raises:
        ValueError: If percepts are not discrete, or the rule does not train such actions.
    """
    if not isinstance(percept_space, Discrete):
        raise ValueError(
            "beta_direct needs Discrete percepts, each of which chooses a specialist, got "
            f"{percept_space}; give a number of percepts, or leave beta_direct out"
        )
    if not rule.looks:
        raise ValueError(
            f"beta_direct: {type(rule).__name__} does not train actions that look at the "
            "signal again; use Projection, ExactGradient or ScoreFunction"
        )
