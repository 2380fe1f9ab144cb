"""J of many agents in one go."""

import torch
from torch import Tensor

from bra.evaluation.evaluation import channel_terms
from bra.objective import Objective
from bra.population.stack import Parts, Stack
from bra.tasks import FiniteStateTask, World

CHUNK = 64
"""Agents that are evaluated at once."""


@torch.no_grad()
def evaluate_stack(
    stack: Stack,
    task: FiniteStateTask,
    world: World,
    beta_perception: Tensor,
    beta_action: Tensor,
) -> Objective[Tensor]:
    """J and its terms, (R,) each, float64, of agents whose percepts and actions can be enumerated.

    The same as `bra.evaluation.evaluate_channels` agent by agent.

    Args:
        stack: R agents, in evaluation mode.
        task: Theirs, with known states.
        world: What they are judged by.
        beta_perception: β₁, (R,).
        beta_action: β₂, (R,).
    """

    def terms_of(parts: Parts, beta_perception: Tensor, beta_action: Tensor) -> dict[str, Tensor]:
        terms, *_ = channel_terms(
            task, parts.perception, parts.action, beta_perception, beta_action, world, task.prior
        )
        return {name: value for name, value in vars(terms).items() if value is not None}

    evaluate = stack.map(terms_of, (0, 0), CHUNK)
    return Objective(**evaluate(stack.state, beta_perception, beta_action))


def gather_objectives(objectives: list[Objective[float]]) -> Objective[Tensor]:
    """J and its terms of agents that were evaluated one by one, (R,) each, float64."""
    columns = {name: [vars(terms)[name] for terms in objectives] for name in vars(objectives[0])}
    return Objective(
        **{
            name: torch.tensor(column, dtype=torch.double)
            for name, column in columns.items()
            if None not in column
        }
    )
