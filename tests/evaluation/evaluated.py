"""Chains to be evaluated."""

import numpy as np
import torch
from gymnasium.spaces import Box

from bra.chain import Chain
from bra.evaluation import evaluate as evaluate_chain
from bra.marginals import default_marginals
from bra.tasks import Task

NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)


NAMES = (
    "objective",
    "expected_utility",
    "perception_information",
    "action_information",
    "end_to_end_information",
)


def channel(cls, *spaces, seed=0, **arguments):
    torch.manual_seed(seed)
    return cls(*spaces, **arguments)


def evaluate(task, perception, action, world=None, betas=(2.0, 3.0)):
    """Over the known states; or over sampled worlds, whose states are not known."""
    task, world = (Hidden(task), world) if world else (task, task.states())
    return evaluate_chain(
        Chain(task, perception, action, default_marginals(task, NUMBER), *betas), world
    )


class Hidden(Task):
    """Another task whose states nobody knows."""

    def __init__(self, task):
        self.task = task
        self.observation_space, self.action_space = task.observation_space, task.action_space

    def sample(self, count, generator):
        return self.task.sample(count, generator)

    def utility(self, state, action):
        return self.task.utility(state, action)
