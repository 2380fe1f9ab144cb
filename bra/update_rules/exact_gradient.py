"""The gradient of J itself, by enumeration."""

import torch
from torch import Tensor

from bra.chain import Chain
from bra.channels.distributions import probabilities
from bra.objective import Objective, table_objective
from bra.tasks import FiniteTask, World
from bra.tasks.base import from_best
from bra.update_rules.base import UpdateRule


class ExactGradient(UpdateRule):
    """Ascends ∂J/∂θ, with J summed over all states, percepts and actions.

    Needs a task with a table of utilities and a noiseless sensor, and percepts that can be
    enumerated. The batch of worlds is not used: every update sees all states, weighted by their
    prior.
    """

    looks = True

    def check(self, chain: Chain) -> None:
        """Asks for a `FiniteTask` and enumerable percepts."""
        problem = None
        if not isinstance(chain.task, FiniteTask):
            problem = f"a FiniteTask, got {type(chain.task).__name__}"
        elif not chain.task.noiseless:
            problem = f"a noiseless sensor, got {type(chain.task).__name__}, whose signals vary"
        elif not chain.perception(chain.task.states().observation[:1]).has_enumerate_support:
            problem = f"percepts that can be enumerated, got {chain.perception.outcome_space}"
        if problem:
            raise ValueError(f"ExactGradient needs {problem}; use ScoreFunction")

    def sees_worlds(self, chain: Chain) -> bool:
        """Never: the task's table says all."""
        return False

    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """−J."""
        task = chain.task
        assert isinstance(task, FiniteTask)  # check() saw to it
        device, dtype = world.state.device, torch.get_default_dtype()
        utilities, best = from_best(task.payoffs.to(device))
        observation = task.states().observation.to(device)
        percept_given = chain.perception(observation)
        terms = table_objective(
            task.prior.to(device, dtype),
            probabilities(percept_given),
            probabilities(chain.responses(observation)),
            utilities,
            chain.beta_perception,
            chain.beta_action,
            chain.beta_direct,
        )
        return -terms.objective, terms.detach().raised(task.prior.to(device) @ best)
