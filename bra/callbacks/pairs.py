"""What agents come to at each pair of prices or budgets."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bra.agent import Learner
from bra.callbacks.baseline import BaselineMonitor
from bra.callbacks.hits import Pair, fares, hit_threshold
from bra.evaluation.references import Reference
from bra.objective import bits, digits, finite

MOST = 12
"""Pairs of prices or budgets up to which a table has a line for each."""


def population_fields(learner: Learner, baseline: BaselineMonitor | None) -> dict[str, Any]:
    """What a summary says of all agents."""
    fare, pairs = fares(learner, baseline)
    return {
        "replicas": fare.agents,
        "hit_rate": fare.hit_rate,
        "hit_rate_low": fare.hit_rate_low,
        "hit_rate_high": fare.hit_rate_high,
        "hit_threshold": None if fare.hit_rate is None else hit_threshold(learner.task),
        "objective_median": fare.objective_median,
        "objective_min": fare.objective_min,
        "prices": [_at(*given, baseline) | vars(fare) for given, fare in pairs.items()],
    }


def _at(prices: Pair, budgets: Pair, baseline: BaselineMonitor | None) -> dict[str, Any]:
    """A pair of prices and its optimum; agents with budgets have optima of their own."""
    first, second = prices
    reference = Reference()
    if baseline and first is not None and second is not None:
        reference = baseline.references[first, second]
    limits = [None if budget is None else budget * math.log(2) for budget in budgets]
    return {
        "beta_perception": first,
        "beta_action": None if second is None else finite(second),
        "perception_budget_nats": limits[0],
        "action_budget_nats": limits[1],
        "blahut_arimoto_objective": reference.objective,
        "blahut_arimoto_error": reference.error,
    }


def pair_lines(rows: Sequence[Mapping[str, Any]], error: float | None) -> list[str]:
    """A line for each pair, for people; none if there is but one.

    Args:
        rows: As `population_fields` has them.
        error: Standard error of J and E[U], or None.
    """
    if len(rows) > MOST:
        budgets = any(rows[0][f"{c}_budget_nats"] is not None for c in ("perception", "action"))
        kind = "budgets" if budgets else "prices"
        return [f"  {len(rows)} pairs of {kind}, see population.csv"]
    return [_line(row, error) for row in rows if len(rows) > 1]


def _line(row: Mapping[str, Any], error: float | None) -> str:
    """The agents of a pair: J at prices that are given, else E[U], which budgets are to buy."""
    limits = row["perception_budget_nats"], row["action_budget_nats"]
    if limits == (None, None):
        name = f"  β₁ {row['beta_perception']:.5g}, β₂ {row['beta_action']:.5g}"
        best, median = (digits(row[f"objective_{n}"], error) for n in ("best", "median"))
        text = f"J {best}" if row["agents"] == 1 else f"J {best}, median {median}"
    else:
        betas = f"β₁ {row['beta_perception']}", f"β₂ {row['beta_action']}"
        parts = [
            beta if limit is None else f"{symbol} {bits(limit):g}"
            for beta, symbol, limit in zip(betas, ("I(Ω;X)", "I(X;A)"), limits, strict=True)
        ]
        name, earned = f"  {', '.join(parts)} bits", digits(row["expected_utility_median"], error)
        text = f"E[U] {earned}" if row["agents"] == 1 else f"E[U] {earned}, the median"
    return f"{name:27} {text}{_reached(row)}"


def _reached(row: Mapping[str, Any]) -> str:
    """How many reached the optimum, and where it is known what J it has."""
    if row["hit_rate"] is None:
        return ""
    optimum = "optimum"
    if row["blahut_arimoto_objective"] is not None:
        optimum += f" {digits(row['blahut_arimoto_objective'], row['blahut_arimoto_error'])},"
    if row["agents"] == 1:
        return f"; {optimum} {'reached' if row['hit_rate'] else 'not reached'}"
    share = share_of(row["hit_rate"], row["hit_rate_low"], row["hit_rate_high"])
    return f"; {optimum} reached by {share}"


def share_of(share: float, low: float | None, high: float | None) -> str:
    """A share of agents and its interval."""
    return f"{share:.0%} of agents (95 %: {low:.0%} to {high:.0%})"
