"""Where the climbs of the serial problem start: action channels p(a|x), percepts equally likely.

The first is the diagonal start of Genewein et al. (2015), in which each percept stands for its own
share of the states. Then follow, in turn,

* percepts that stand for the actions which the disturbed one-channel optimum uses most,
* covering starts, in which the percepts share out a random part of the actions,
* perceptions at random, from vague to sharp.

None of the kinds is best for all utilities and prices.
"""

import torch
from torch import Tensor

from bra.blahut_arimoto.serial_problem import SerialProblem

_TINY = torch.finfo(torch.float64).tiny


def starts(
    problem: SerialProblem, one_channel: Tensor, percepts: int, restarts: int, seed: int
) -> Tensor:
    """Starting points (A + 1, X, cells · restarts): the same draws for every pair of prices.

    Args:
        problem: Utilities, prior and prices.
        one_channel: Optimal p(a|ω) of one channel for each pair of prices, (cells, W, A).
        percepts: Number of percepts |X|.
        restarts: Number of starts for each pair of prices; more of them include fewer.
        seed: Seed of the draws.
    """
    cells, states, actions = one_channel.shape
    beta_2 = problem.beta_2[::restarts, None, None, None]
    distance = torch.arange(states)[:, None] - torch.arange(percepts)
    diagonal = (distance % min(states, percepts) == 0).double()
    logits = beta_2 * _worth(problem, diagonal)
    if restarts > 1:
        generator = torch.Generator().manual_seed(seed)
        rounds = [_draw(states, percepts, actions, generator) for _ in range(1, restarts, 3)]
        disturbance, cover, perception = (torch.stack(draws) for draws in zip(*rounds, strict=True))
        kinds = (
            beta_2 * _worth_of_actions(problem, one_channel, disturbance, percepts),
            cover.expand(cells, -1, -1, -1),
            beta_2 * _worth(problem, perception.softmax(2)),
        )
        in_turn = torch.stack(kinds, 2).flatten(1, 2)
        logits = torch.cat((logits, in_turn), 1)[:, :restarts]
    rows = logits.flatten(0, 1).permute(2, 1, 0).log_softmax(0)
    return torch.cat((rows, torch.full_like(rows[:1], 1 / percepts).log()))


def _draw(
    states: int, percepts: int, actions: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Logits of a disturbance (W, A), a covering action channel (X, A), a perception (W, X)."""

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    disturbance_scale, share, sharpness = torch.rand(3, generator=generator).tolist()
    chosen = torch.randperm(actions, generator=generator)[: 1 + int(share * actions)]
    favourite = chosen[torch.arange(percepts) % len(chosen)]
    return (
        3 * disturbance_scale * noise(states, actions),
        5 * torch.nn.functional.one_hot(favourite, actions) + noise(percepts, actions),
        10 * sharpness * noise(states, percepts),
    )


def _worth_of_actions(
    problem: SerialProblem, one_channel: Tensor, disturbance: Tensor, percepts: int
) -> Tensor:
    """E[U|x] (cells, draws, X, A) where percept x means the x-th most used action.

    Percepts beyond the number of actions begin as copies.
    """
    log_channel = one_channel.clamp(min=_TINY).log()
    disturbed = (log_channel[:, None] + disturbance).softmax(3)
    order = (problem.prior @ disturbed).argsort(dim=2, descending=True, stable=True)
    actions = order.shape[2]
    meaning = order[..., torch.arange(percepts) % actions, None]
    return _worth(problem, disturbed).gather(2, meaning.expand(-1, -1, -1, actions))


def _worth(problem: SerialProblem, channel: Tensor) -> Tensor:
    """E[U|y] (..., Y, A) for a channel p(y|ω) (..., W, Y); states without mass barely count."""
    joint = channel * (problem.prior[:, None] + _TINY)
    return (joint / joint.sum(-2, keepdim=True)).mT @ problem.utilities
