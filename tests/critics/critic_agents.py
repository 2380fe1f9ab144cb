"""Agents with critics."""

from functools import partial

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete

from bra import Agent, PredatorPrey
from bra.channels import MLP, Multinomial
from bra.tasks import Task, World
from bra.update_rules import Projection

UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0]]


class Frames(Task):
    """Two states behind a noisy sensor; says which utilities it was asked for."""

    def __init__(self, noise=0.1):
        self.noise = noise
        self.observation_space = Box(-np.inf, np.inf, (3,), np.float32)
        self.action_space = Discrete(3)
        self.asked = []

    def sample(self, count, generator):
        state = torch.randint(2, (count,), generator=generator)
        signal = torch.tensor([[1.0, 0, 1], [0, 1, 1]])[state]
        return World(state, signal + self.noise * torch.randn(count, 3, generator=generator))

    def utility(self, state, action):
        self.asked.append((state, action))
        return torch.tensor(UTILITIES)[state, action]


def make_agent(task=None, critic=None, exploration=None, **own):
    settings = {
        "perception": partial(MLP, hidden=[16]),
        "action": partial(Multinomial, start="covering"),
        "percepts": 4,
        "beta_perception": 3.0,
        "beta_action": 4.0,
        "update_rule": Projection(critic=critic, exploration=exploration),
        "perception_optimizer": partial(torch.optim.Adam, lr=0.01),
        "action_optimizer": partial(torch.optim.Adam, lr=0.05),
        "seed": 0,
    }
    return Agent(task or PredatorPrey(observations="bipolar"), **(settings | own))
