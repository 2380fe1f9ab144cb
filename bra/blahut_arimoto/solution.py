"""The search for an optimum, and what its end means for the problem that was asked."""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot, pad

from bra.blahut_arimoto.certificate import CLOSED, Certificate, certify_gap
from bra.blahut_arimoto.climb import SWEEP_CAP
from bra.blahut_arimoto.reduction import Reduction, reduced
from bra.blahut_arimoto.results import warn_cap
from bra.blahut_arimoto.search import Plan, search
from bra.blahut_arimoto.serial_problem import SerialProblem
from bra.blahut_arimoto.tight_bound import Bounds, bounds
from bra.checks.memory import check_memory
from bra.checks.settings import check_count, check_seconds, check_seed
from bra.checks.words import amount

# Batches of a default budget, and how many numbers p(a|x), a state each, all its starts may have.
_BATCHES, _ROOM = 16, 10**8

# Joint probability below which a state does not claim a percept, but leaks into it.
_LEAK = 1e-20
# Percepts that a search may use beyond as many as there are states, which an optimum can do with.
_SPARE = 3


class Effort(NamedTuple):
    """How much may be searched; see `serial`."""

    percepts: int
    restarts: int
    budget: int | None
    seed: int
    certify: float | None = None

    @classmethod
    def checked(
        cls,
        percepts: int,
        restarts: int,
        budget: int | None,
        seed: int,
        certify: float | None = None,
    ) -> "Effort":
        """The same of arguments that people gave."""
        if budget is not None:
            budget = check_count(budget, "budget")
        percepts, restarts = check_count(percepts, "percepts"), check_count(restarts, "restarts")
        check_memory(16 * percepts, f"percepts {percepts:,}")
        seed = check_seed(seed)
        seconds = None if certify is None else check_seconds(certify, "certify")
        return cls(percepts, restarts, budget, seed, seconds)


def best_of_many(
    problem: Reduction, chain: SerialProblem, bounds: Bounds, effort: Effort
) -> dict[str, Tensor]:
    """The best end of many climbs, and what there is to say of them, for B sets of prices.

    Args:
        problem: The problem, reduced.
        chain: The same, as climbs see it.
        bounds: For each set of prices.
        effort: Of the search.

    """
    plan = _plan(chain, bounds, effort)
    point, ends = search(plan)
    cap = f"{SWEEP_CAP} sweeps"
    warn_cap(
        chain.solver, ends.converged.flatten(), cap, problem.unit * ends.gap.flatten(), depth=2
    )
    best = ends.value.nan_to_num(nan=-torch.inf).amax(1)
    proven = torch.maximum(best, plan.problem.percept_free().value)
    proof = Certificate(torch.inf, 0)
    if effort.certify is not None:
        proof = certify_gap(problem, proven.item(), bounds.tight.item(), effort.certify)
    tight = bounds.tight.clamp(max=proof.bound)
    return _solution(problem, chain, point, best, effort.percepts) | {
        "upper_bound": problem.value(bounds.upper),
        "tight_bound": problem.value(tight),
        "nodes": torch.full_like(best, proof.nodes, dtype=torch.int64),
        "closed": tight - proven <= CLOSED * problem.regret,
        "optima": problem.value(ends.value),
        "starts": (~ends.value.isnan()).sum(1),
        "hits": ends.hits(plan.problem, proven),
        "iterations": ends.sweeps.amax(1),
        "converged": ends.converged.all(1),
    }


def solve_serial(
    table: Tensor, prior: Tensor, effort: Effort, beta_1: Tensor, beta_2: Tensor
) -> dict[str, Tensor]:
    """The entries of `Serial` for B pairs of prices; see there."""
    problem = reduced(table, prior, effort.percepts, beta_1, beta_2)
    chain = SerialProblem(problem.utilities, problem.prior, *problem.prices, problem.regret)
    bound = bounds(problem.utilities, problem.prior, *problem.prices, effort.percepts)
    terms = best_of_many(problem, chain, bound, effort)
    refuse_forbidden(terms, table, prior, effort.percepts)
    return terms


def refuse_forbidden(terms: dict[str, Tensor], table: Tensor, prior: Tensor, percepts: int) -> None:
    """Raises ValueError if solutions for utilities (W, A) and a prior (W,) take what is −inf."""
    if terms["action_given_state"][:, table.isneginf() & (prior > 0)[:, None]].any():
        raise ValueError(
            f"found no policy of {amount(percepts, 'percept')} that never takes a forbidden "
            "action; allow more percepts, or give large negative utilities instead of -inf"
        )


def _plan(chain: SerialProblem, bounds: Bounds, effort: Effort) -> Plan:
    """The search, without states that never occur."""
    occurs = chain.prior > 0
    chain = replace(chain, utilities=chain.utilities[occurs], prior=chain.prior[occurs])
    restarts, budget = effort.restarts, effort.budget
    percepts = min(effort.percepts, len(chain.utilities) + _SPARE)
    # A start is a channel in float64, and there are copies of it to compare and to move on.
    size = 4 * 8 * restarts * percepts * len(chain.utilities)
    check_memory(size, amount(restarts, "restart"))
    if budget is None:
        batches = _ROOM // (restarts * percepts * chain.utilities.numel())
        budget = restarts * max(1, min(_BATCHES, batches))
    return Plan(
        problem=chain,
        one_channel=bounds.channel[:, occurs],
        bound=bounds.tight,
        percepts=percepts,
        restarts=restarts,
        budget=max(restarts, budget),
        seed=effort.seed,
    )


def _solution(
    problem: Reduction, chain: SerialProblem, point: Tensor, value: Tensor, percepts: int
) -> dict[str, Tensor]:
    """J, its terms and the channels at one point (K + 1, X, B) of a J (B,) for each set of prices.

    What is best without percepts takes the place of channels that are no better, to rounding.
    Percepts that the point does without are added as ones that no state leads to.
    """
    perception, action = chain.channels(point)
    if problem.forbidden.any() and action.ndim == 3:
        perception, action = _without_leaks(problem, perception, action)
    free = chain.percept_free()
    silent = value <= free.value + chain.tolerance()
    first = one_hot(torch.tensor(0), point.shape[1]).to(perception)
    perception = torch.where(silent[:, None, None], first, perception)
    action = torch.where(silent.view(-1, *[1] * (action.ndim - 1)), free.action, action)
    terms = chain.terms(perception, action)
    nothing = torch.zeros_like(free.value)
    exact = {
        "perception_information": nothing,
        "action_information": nothing,
        "end_to_end_information": free.information,
        "objective": free.value,
    }
    for name, value in exact.items():  # a low price makes much of rounding
        terms[name] = torch.where(silent, value, terms[name])
    for name in ("objective", "expected_utility"):
        terms[name] = problem.value(terms[name])
    for name in terms:
        if name.startswith("action_given") or name == "action_marginal":
            terms[name] = problem.all_actions(terms[name])
        if name.endswith("_state"):
            terms[name] = problem.all_states(terms[name])
    spare = percepts - point.shape[1]
    for name in ("percept_given_state", "percept_marginal"):
        terms[name] = pad(terms[name], (0, spare))
    for name in terms.keys() & {"action_given_percept", "action_given_percept_and_state"}:
        rows = terms[name]
        terms[name] = torch.cat((rows, rows[:, :1].expand(-1, spare, *rows.shape[2:])), 1)
    return terms


def _without_leaks(problem: Reduction, perception: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
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
