"""J of many agents in one go."""

from typing import cast

import torch
from gymnasium.spaces import Discrete
from torch import Tensor

from bra.blocks.modules import Modules
from bra.chain import Chain
from bra.evaluation import chain_terms
from bra.objective import Objective
from bra.population.stack import Stack
from bra.tasks import World

CHUNK = 64
"""Agents that are evaluated at once at least,"""
NUMBERS = 2**18
"""and as many as have no more numbers than this in their channels' tables."""


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

    percepts, actions = (
        cast(Discrete, channel.outcome_space).n
        for channel in (stack.modules.perception, stack.modules.action)
    )
    tables = int(len(world.state) * (percepts + actions) + percepts * actions)
    evaluate = stack.map(terms_of, (0,), max(CHUNK, NUMBERS // tables))
    return Objective(**evaluate(stack.state, betas))


def gather_objectives(objectives: list[Objective[float]]) -> Objective[Tensor]:
    """J and its terms of agents that were evaluated one by one, (R,) each, float64."""
    names = objectives[0].known()
    columns = {name: [getattr(terms, name) for terms in objectives] for name in names}
    return Objective(**{n: torch.tensor(c, dtype=torch.double) for n, c in columns.items()})
