"""Chains and targets of the projection rule."""

import torch
from gymnasium.spaces import Discrete

from bra.channels import Table
from bra.marginals import ExactMarginals
from bra.tasks import TableTask, Task
from bra.update_rules import Chain, Projection

UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]


PRIOR = [0.5, 0.3, 0.2]


BETA_1, BETA_2 = 2.0, 3.0


class Hidden(Task):
    """A finite task that does not say which states it has."""

    def __init__(self, utilities=UTILITIES, prior=PRIOR):
        self.table = TableTask(utilities, prior=prior, observations="index")
        self.observation_space = self.table.observation_space
        self.action_space = self.table.action_space

    def sample(self, count, generator):
        return self.table.sample(count, generator)

    def utility(self, state, action):
        return self.table.utility(state, action)


def make_chain(task=None, perception=Table, action=Table, percepts=4, marginals=None, **prices):
    task = task or TableTask(UTILITIES, prior=PRIOR, observations="index")
    torch.manual_seed(1)
    return Chain(
        task,
        perception(task.observation_space, Discrete(percepts)),
        action(Discrete(percepts), task.action_space),
        marginals or ExactMarginals(),
        **({"beta_perception": BETA_1, "beta_action": BETA_2} | prices),
    )


def checked(chain, **arguments):
    rule = Projection(**arguments)
    rule.check(chain)
    return rule


def gradients(chain, loss):
    logits = [chain.perception.logits, chain.action.logits]
    return [gradient.double() for gradient in torch.autograd.grad(loss, logits)]
