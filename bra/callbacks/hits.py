"""Which agents reached the optimum at their own prices."""

import math
from dataclasses import dataclass, replace

from torch import Tensor

from bra.agent import Learner
from bra.callbacks.baseline import BaselineMonitor
from bra.tasks import FiniteTask, Task

Pair = tuple[float | None, float | None]
Given = tuple[Pair, Pair]
"""Prices of two channels, None where they follow budgets, and budgets, bits, None where not."""
HIT = 0.005
"""Share of the range of utilities up to which an agent may miss an optimum that it has reached."""


@dataclass(frozen=True)
class Fare:
    """How some agents fare.

    Attributes:
        agents: How many there are.
        objective_best: The highest J.
        objective_median: The median of J.
        objective_min: The lowest J.
        expected_utility_median: The median of E[U].
        hit_rate: Share that reached the optimum; None where none is known, as the next two.
        hit_rate_low: Lower end of its 95 % interval, see `wilson`.
        hit_rate_high: Upper end.
    """

    agents: int
    objective_best: float
    objective_median: float
    objective_min: float
    expected_utility_median: float
    hit_rate: float | None = None
    hit_rate_low: float | None = None
    hit_rate_high: float | None = None


def fares(learner: Learner, baseline: BaselineMonitor | None) -> tuple[Fare, dict[Given, Fare]]:
    """How all agents fare, and those of each pair of prices or budgets."""
    terms, hit = learner.evaluate_members(), hits(learner, baseline)
    objectives, utilities = terms.objective, terms.expected_utility
    given = [(setting.given_prices, setting.budgets) for setting in learner.settings]
    pairs = {}
    for pair in dict.fromkeys(given):
        own = objectives.new_tensor([other == pair for other in given]).bool()
        pairs[pair] = _fare(objectives[own], utilities[own], None if hit is None else hit[own])
    return _fare(objectives, utilities, hit), pairs


def _fare(objectives: Tensor, utilities: Tensor, hit: Tensor | None) -> Fare:
    best, median, least = objectives.max(), objectives.quantile(0.5), objectives.min()
    earned = utilities.quantile(0.5).item()
    found = Fare(len(objectives), best.item(), median.item(), least.item(), earned)
    if hit is None:
        return found
    low, high = wilson(int(hit.sum()), len(hit))
    share = hit.double().mean().item()
    return replace(found, hit_rate=share, hit_rate_low=low, hit_rate_high=high)


def gaps(learner: Learner, baseline: BaselineMonitor | None) -> Tensor | None:
    """Optimum at its own prices minus J of each agent, (R,); None where no optimum is known.

    None is known at prices that are on their way to budgets.
    """
    if baseline is None:
        return None
    found = [baseline.references.get(setting.prices) for setting in learner.settings]
    optima = [reference and reference.objective for reference in found]
    objectives = learner.objectives()
    known = [optimum for optimum in optima if optimum is not None]
    return objectives.new_tensor(known) - objectives if len(known) == len(objectives) else None


def hits(learner: Learner, baseline: BaselineMonitor | None) -> Tensor | None:
    """Whether each agent reached the optimum at its own prices, (R,); None where none is known.

    It has if its gap is at most `hit_threshold`, plus the error of the optimum and two standard
    errors of its J, where these are estimated.
    """
    missing, threshold = gaps(learner, baseline), hit_threshold(learner.task)
    if baseline is None or missing is None or threshold is None:
        return None
    errors = [baseline.references[setting.prices].error for setting in learner.settings]
    slack, spread = missing.new_tensor(errors), learner.evaluate_members().standard_error
    return missing <= threshold + (slack if spread is None else slack + 2 * spread)


def hit_threshold(task: Task) -> float | None:
    """Gap to the optimum, in units of utility, up to which an agent has reached it.

    A fixed share of the range of utilities, so that it means the same in any unit; None without a
    table of utilities.
    """
    return HIT * task.utility_range if isinstance(task, FiniteTask) else None


def wilson(count: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval of a share, at 95 % (Wilson 1927).

    (p + z²/2n ± z √(p(1 − p)/n + z²/4n²)) / (1 + z²/n) with p = count/n.
    """
    share, spread = count / trials, z * z / trials
    centre = (share + spread / 2) / (1 + spread)
    half = z * math.sqrt(share * (1 - share) / trials + spread / trials / 4) / (1 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)
