"""Small chains of specialists."""

import torch
from gymnasium.spaces import Discrete, Tuple

from bra import TableTask
from bra.chain import Chain
from bra.channels import Table
from bra.channels.distributions import probabilities
from bra.marginals import ExactMarginals
from bra.objective import table_objective
from bra.tasks import TargetTask, Task

UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]


PRIOR = [0.5, 0.3, 0.2]


PRICES = (2.0, 3.0, 1.5)


SIGNALS = {
    "index": "index",
    "vector": [[0.0, 1.0], [1.0, 0.0], [1.0, 1.0]],
    "image": torch.randn(3, 1, 3, 3, generator=torch.Generator().manual_seed(0)),
}


class Hidden(Task):
    """A table whose states the agent does not know: it draws them."""

    def __init__(self):
        self.table = TableTask(UTILITIES, prior=PRIOR, observations="index")
        self.observation_space, self.action_space = Discrete(3), Discrete(3)

    def sample(self, count, generator):
        return self.table.sample(count, generator)

    def utility(self, state, action):
        return self.table.utility(state, action)


def make_chain(perception=Table, action=Table, signals="index", target=False, marginals=None):
    arguments = {"prior": PRIOR, "observations": SIGNALS[signals]}
    targets = [[-1.0], [0.5], [2.0]]
    task = TargetTask(targets, **arguments) if target else TableTask(UTILITIES, **arguments)
    return chain_of(task, perception, action, marginals or ExactMarginals())


def chain_of(task, perception, action, marginals):
    torch.manual_seed(2)
    percepts = Discrete(3)
    first = perception(task.observation_space, percepts)
    second = action(Tuple((percepts, task.observation_space)), task.action_space)
    marginals.check(task, percepts)
    marginals.check_looks(task, percepts)
    return Chain(task, first, second, marginals, *PRICES)


def exact_terms(chain):
    """J and its terms by enumeration; densities are summed on a grid."""
    task, second = chain.task, chain.second_look(chain.task.observations)
    if isinstance(task, TargetTask):
        grid = torch.linspace(-9, 9, 3001)
        table = second.log_prob(grid[:, None, None, None]).double().movedim(0, -1).softmax(-1)
        utilities = -(task.targets - grid).square().double()
    else:
        table, utilities = probabilities(second).double(), task.utilities
    percepts = probabilities(chain.perception(task.observations)).double()
    return table_objective(task.prior, percepts, table, utilities, *PRICES)
