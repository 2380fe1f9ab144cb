"""J of many agents in one go."""

import torch
from torch import Tensor

from bra.blocks.modules import Modules
from bra.chain import Chain
from bra.evaluation import chain_terms
from bra.objective import Objective
from bra.population.stack import Stack
from bra.tasks import World

CHUNK = 64
"""Agents that are evaluated at once."""


@torch.no_grad()
def evaluate_stack(stack: Stack, world: World, betas: tuple[Tensor, ...]) -> Objective[Tensor]:
    """J and its terms, (R,) each, float64, of agents whose percepts and actions can be enumerated.

    The same as `bra.evaluation.evaluate` agent by agent.

    Args:
        stack: R agents, in evaluation mode, whose task has known states.
        world: What they are judged by.
        betas: β₁, β₂ and, where actions look at the signal again, β₃, (R,) each, float64.
    """

    def terms_of(modules: Modules, betas: tuple[Tensor, ...]) -> dict[str, Tensor]:
        return chain_terms(Chain.of(modules, *betas), world).known()

    evaluate = stack.map(terms_of, (0,), CHUNK)
    return Objective(**evaluate(stack.state, betas))


def gather_objectives(objectives: list[Objective[float]]) -> Objective[Tensor]:
    """J and its terms of agents that were evaluated one by one, (R,) each, float64."""
    names = objectives[0].known()
    columns = {name: [getattr(terms, name) for terms in objectives] for name in names}
    return Objective(**{n: torch.tensor(c, dtype=torch.double) for n, c in columns.items()})
