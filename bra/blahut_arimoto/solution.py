"""What the end of a climb means for the problem that was asked."""

import torch
from torch import Tensor
from torch.nn.functional import one_hot, pad

from bra.blahut_arimoto.reduction import Reduction
from bra.blahut_arimoto.serial_problem import SerialProblem

# Joint probability below which a state does not claim a percept, but leaks into it.
_LEAK = 1e-20

INFORMATION = ("perception_information", "action_information", "end_to_end_information")


def solution(problem: Reduction, point: Tensor, value: Tensor, percepts: int) -> dict[str, Tensor]:
    """J, its terms and the channels at one point (K + 1, X, B) of a J (B,) for each pair of prices.

    The best single action takes the place of channels that are no better, to rounding. Percepts
    that the point does without are added as ones that no state leads to.
    """
    serial = SerialProblem(problem.utilities, problem.prior, *problem.prices, problem.regret)
    perception, action = serial.channels(point)
    if problem.forbidden.any():
        perception, action = without_leaks(problem, perception, action)
    constant = problem.prior @ problem.utilities
    silent = value <= constant.amax() + serial.tolerance()
    single = one_hot(constant.argmax(), len(constant)).to(action)
    first = one_hot(torch.tensor(0), point.shape[1]).to(perception)
    terms = serial.terms(
        torch.where(silent[:, None, None], first, perception),
        torch.where(silent[:, None, None], single, action),
    )
    for name in INFORMATION:  # exactly: a low price makes much of rounding
        terms[name] = torch.where(silent, 0.0, terms[name])
    terms["objective"] = torch.where(silent, terms["expected_utility"], terms["objective"])
    for name in ("objective", "expected_utility"):
        terms[name] = problem.value(terms[name])
    for name in ("action_given_state", "action_given_percept", "action_marginal"):
        terms[name] = problem.all_actions(terms[name])
    for name in ("action_given_state", "percept_given_state"):
        terms[name] = problem.all_states(terms[name])
    spare = percepts - point.shape[1]
    for name in ("percept_given_state", "percept_marginal"):
        terms[name] = pad(terms[name], (0, spare))
    rows = terms["action_given_percept"]
    terms["action_given_percept"] = torch.cat((rows, rows[:, :1].expand(-1, spare, -1)), 1)
    return terms


def without_leaks(problem: Reduction, perception: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """Channels (B, S, X) and (B, X, K) that never take a forbidden action, if that is but a leak.

    A percept gives up the actions that are forbidden in a state which claims it. States that only
    leak into a percept stay away from it if it may still lead to what they forbid.
    """
    forbidden = problem.forbidden.double()
    claims = (problem.prior[:, None] * perception > _LEAK).double()
    action = _renormalised(action, claims.mT @ forbidden == 0)
    risk = forbidden @ action.mT
    return _renormalised(perception, (risk == 0) | (claims > 0)), action


def _renormalised(channel: Tensor, admissible: Tensor) -> Tensor:
    """The channel without what is not admissible; rows of which nothing would be left stay."""
    left = channel * admissible
    total = left.sum(-1, keepdim=True)
    return torch.where(total > 0, left / total, channel)
