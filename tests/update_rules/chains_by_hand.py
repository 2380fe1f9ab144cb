"""Chains with known gradients."""

from functools import partial

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete

from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.marginals import ExactMarginals
from bra.tasks import TableTask, TargetTask
from bra.update_rules import Chain

NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)


UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]


PRIOR = [0.5, 0.3, 0.2]


SIGNALS = {
    "index": "index",
    "vector": [[0.0, 1.0], [1.0, 0.0], [1.0, 1.0]],
    "image": torch.randn(3, 1, 3, 3, generator=torch.Generator().manual_seed(0)),
}


TARGETS = [[-1.0], [0.5], [2.0]]


START = torch.randn(2, 3, generator=torch.Generator().manual_seed(1))


def make_chain(perception, action, percepts=None, signals="index", target=False):
    arguments = {"prior": PRIOR, "observations": SIGNALS[signals]}
    task = TargetTask(TARGETS, **arguments) if target else TableTask(UTILITIES, **arguments)
    percepts = percepts or Discrete(3)
    torch.manual_seed(2)
    first = perception(task.observation_space, percepts)
    second = action(percepts, task.action_space)
    return Chain(task, first, second, ExactMarginals(), 2.0, 3.0)


def parameters(chain):
    return [*chain.perception.parameters(), *chain.action.parameters()]


def flat_gradient(loss, chain):
    gradients = torch.autograd.grad(loss, parameters(chain))
    return torch.cat([gradient.flatten() for gradient in gradients]).double()


CHAINS = {
    "network of the paper": (partial(MLP, hidden=[5], bias=False), Multinomial, None, "vector"),
    "network and network": (partial(MLP, hidden=[4]), MLP, None, "vector"),
    "table and table": (Table, Table),
    "table and multinomial": (Table, partial(Multinomial, reference=1, start=START)),
    "multinomial and table": (partial(Multinomial, start=START), Table),
    "convolutions": (partial(CNN, channels=[2]), Table, None, "image"),
    "gaussian percepts": (Gaussian, partial(MLP, hidden=[4]), NUMBER),
    "network to gaussian percepts": (MLP, partial(MLP, hidden=[4]), NUMBER, "vector"),
    "gaussian actions": (Table, Gaussian, None, "index", True),
    "network to gaussian actions": (Table, partial(MLP, hidden=[]), None, "index", True),
}
