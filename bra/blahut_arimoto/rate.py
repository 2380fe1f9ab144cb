"""One channel Ω → A at a given rate: the most that so much information can earn."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from bra.blahut_arimoto.one_channel import rate_distortion
from bra.blahut_arimoto.results import RateDistortion
from bra.checks.arrays import Array
from bra.checks.prices import check_rate
from bra.checks.tables import check_prior, check_utilities
from bra.information import mutual_information

DEAR, CHEAP = 1e-15, 1e9
"""Prices β, per range of the utilities, at which information is worth or costs nothing."""
CLOSE = 1e-12
"""Share of the range of the utilities up to which bound and value are one."""
MOST_STEPS = 100
JUMP, ASIDE = 1e-3, 1e-6
"""Nats from which a rate jumps; share of the price, to both sides of it, at which to look."""


@dataclass(frozen=True)
class AtRate:
    """The most that a channel Ω → A of no more than a given rate earns.

    Attributes:
        expected_utility: E[U(ω,a)] of the returned channel, in utility units.
        end_to_end_information: I(Ω;A) in nats, no more than was given.
        beta: Price β, per nat, at which an agent would choose this rate by itself; `inf` where more
            information would earn nothing.
        action_given_state: p(a|ω), (W, A).
        action_marginal: p(a), (A,).
        upper_bound: No channel of this rate has a larger E[U].
        jump: The rates in nats between which no price leads, at a first-order transition at which
            both are as good; this rate lies between, and the channel is their mixture. None if the
            rate is that of a price.
    """

    expected_utility: float
    end_to_end_information: float
    beta: float
    action_given_state: Tensor
    action_marginal: Tensor
    upper_bound: float
    jump: tuple[float, float] | None


def at_rate(utilities: Array, prior: Array | None, bits: float) -> AtRate:
    """Max E[U(ω,a)] over p(a|ω) with I(Ω;A) ≤ R, the rate–utility function of one channel.

    It is concave in R. By Lagrangian duality it is min over β of J*(β) + R/β, J*(β) the optimum of
    `rate_distortion`, so that J* plus its certified gap gives an upper bound at every β. The best β
    is bracketed by optima of lower and of higher rate and found by turns at the slope of the chord
    between their (I, E[U]), where the chord itself may be the optimum, and by bisection. The
    mixture of both ends that has the rate R by the chord has this E[U] and, as I(Ω;A) is convex in
    the channel, no more than R.

    Args:
        utilities: U(ω,a), (W, A); −inf for an action that is forbidden in a state.
        prior: p(ω), (W,); None for uniform.
        bits: R ≥ 0 in bits.

    Raises:
        ValueError: If an argument cannot be read as numbers, or R is not admissible.
    """
    rate = check_rate(bits, "bits") * math.log(2)
    table = check_utilities(utilities)
    p = check_prior(prior, len(table))
    finite = table[table.isfinite()]
    spread = (finite.amax() - finite.amin()).item() or 1.0

    def solve(beta: float) -> "_End":
        return _End(beta, rate_distortion(table, p, beta))

    low, high = solve(DEAR / spread), solve(CHEAP / spread)
    if high.rate <= rate:
        best = (p @ table.amax(1)).item()
        return _result(high, high, 0.0, best, math.inf, p, None)
    bound = min(low.bound(rate), high.bound(rate))
    for step in range(MOST_STEPS):
        if bound - low.mixed(high, low.weight(high, rate)) <= CLOSE * spread:
            break
        middle = solve(_between(low, high, by_chord=step % 2 == 0))
        bound = min(bound, middle.bound(rate))
        low, high = (middle, high) if middle.rate <= rate else (low, middle)
    beta, weight, jump = low.slope(high), low.weight(high, rate), None
    if 0 < weight < 1 and high.rate - low.rate > JUMP:
        jump = solve(beta * (1 - ASIDE)).rate, solve(beta * (1 + ASIDE)).rate
    return _result(low, high, weight, bound, beta, p, jump)


@dataclass(frozen=True)
class _End:
    """The optimum at a price."""

    beta: float
    found: RateDistortion

    @property
    def rate(self) -> float:
        return float(self.found.end_to_end_information)

    @property
    def utility(self) -> float:
        return float(self.found.expected_utility)

    def bound(self, rate: float) -> float:
        """What no channel of a rate exceeds."""
        return float(self.found.upper_bound) + rate / self.beta

    def weight(self, other: "_End", rate: float) -> float:
        """Share of the other in a mixture that has a rate by the chord."""
        return max(0.0, (rate - self.rate) / (other.rate - self.rate))

    def mixed(self, other: "_End", weight: float) -> float:
        """E[U] of a mixture."""
        return self.utility + weight * (other.utility - self.utility)

    def slope(self, other: "_End") -> float:
        """β at which both are as good; within the prices of both."""
        gain = other.utility - self.utility
        beta = (other.rate - self.rate) / gain if gain > 0 else math.inf
        return min(max(beta, self.beta), other.beta)


def _between(low: _End, high: _End, by_chord: bool) -> float:
    beta = low.slope(high)
    if by_chord and low.beta < beta < high.beta:
        return beta
    return math.sqrt(low.beta) * math.sqrt(high.beta)


def _result(
    low: _End,
    high: _End,
    weight: float,
    bound: float,
    beta: float,
    prior: Tensor,
    jump: tuple[float, float] | None,
) -> AtRate:
    """The mixture of both ends."""
    ends = low.found.action_given_state, high.found.action_given_state
    channel = torch.lerp(*ends, weight)
    return AtRate(
        expected_utility=low.mixed(high, weight),
        end_to_end_information=mutual_information(prior, channel).item(),
        beta=beta,
        action_given_state=channel,
        action_marginal=prior @ channel,
        upper_bound=bound,
        jump=jump,
    )
