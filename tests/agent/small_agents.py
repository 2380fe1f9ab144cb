"""Small agents."""

from functools import partial

import torch
from torch.optim.lr_scheduler import ExponentialLR

from bra import Agent, PredatorPrey
from bra.channels import MLP
from bra.marginals import RunningMarginals
from bra.update_rules import ScoreFunction


def make_agent(**own):
    """An agent with a state of its own in every part that a checkpoint has to hold."""
    settings = {
        "percepts": 5,
        "beta_perception": 8.0,
        "beta_action": 10.0,
        "perception": partial(MLP, hidden=[7]),
        "update_rule": ScoreFunction(samples=2, baseline="running"),
        "marginals": RunningMarginals(),
        "perception_optimizer": partial(torch.optim.Adam, lr=0.01),
        "action_optimizer": partial(torch.optim.SGD, lr=0.1, momentum=0.9),
        "perception_scheduler": partial(ExponentialLR, gamma=0.99),
        "seed": 3,
    }
    return Agent(PredatorPrey(), **(settings | own))
