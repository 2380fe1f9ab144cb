"""What the solvers return, with a leading dimension for each dimension of the prices."""

import warnings
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True)
class RateDistortion:
    """Optimum of one channel Ω → A: J = E[U] − (1/β) I(Ω;A).

    For a tensor of prices every entry has its shape (...) in front; for one price the scalars are
    Python numbers.

    Attributes:
        objective: J of the returned channel, in utility units.
        expected_utility: E[U(ω,a)].
        end_to_end_information: I(Ω;A) in nats.
        action_given_state: p(a|ω), shape (..., W, A).
        action_marginal: p(a) = Σ p(ω) p(a|ω), shape (..., A).
        upper_bound: No channel has a larger J than this; `objective + gap`.
        gap: Certified distance from J to the optimum, in utility units.
        iterations: Newton steps taken.
        converged: Whether the gap reached the tolerance.
    """

    objective: float | Tensor
    expected_utility: float | Tensor
    end_to_end_information: float | Tensor
    action_given_state: Tensor
    action_marginal: Tensor
    upper_bound: float | Tensor
    gap: float | Tensor
    iterations: int | Tensor
    converged: bool | Tensor


@dataclass(frozen=True)
class Serial:
    """Best optimum found of the chain Ω → X → A: J = E[U] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A).

    For tensors of prices every entry has their broadcast shape (...) in front; for two numbers the
    scalars are Python numbers.

    Attributes:
        objective: J of the returned channels, in utility units: the first of `optima` that equals
            the largest up to the tolerance.
        expected_utility: E[U(ω,a)].
        perception_information: I(Ω;X) in nats.
        action_information: I(X;A) in nats.
        end_to_end_information: I(Ω;A) in nats.
        action_given_state: p(a|ω) = Σ p(x|ω) p(a|x), shape (..., W, A).
        percept_given_state: p(x|ω), shape (..., W, X).
        action_given_percept: p(a|x), shape (..., X, A). The row of a percept that is never used
            says nothing.
        percept_marginal: p(x) = Σ p(ω) p(x|ω), shape (..., X).
        action_marginal: p(a) = Σ p(x) p(a|x), shape (..., A).
        upper_bound: No pair of channels, whatever the number of percepts, has a larger J.
        tight_bound: No pair of channels with that many percepts has a larger J; at most as large as
            `upper_bound`.
        nodes: Boxes that `certify` looked at, 0 without it. `tight_bound` holds what it proved.
        closed: Whether `bound` is that close to `objective` that `certify` has nothing left to do.
        optima: J at the end of every climb in turn, shape (..., n); NaN where other prices needed
            more of them.
        starts: How many climbs there were.
        hits: How many of them led to the returned optimum, other than moves away from it. Where it
            is 1, more starts may well find a better one.
        iterations: Blahut-Arimoto sweeps of the climb that took most.
        converged: Whether every climb ended at a certified stationary point.
    """

    objective: float | Tensor
    expected_utility: float | Tensor
    perception_information: float | Tensor
    action_information: float | Tensor
    end_to_end_information: float | Tensor
    action_given_state: Tensor
    percept_given_state: Tensor
    action_given_percept: Tensor
    percept_marginal: Tensor
    action_marginal: Tensor
    upper_bound: float | Tensor
    tight_bound: float | Tensor
    nodes: int | Tensor
    closed: bool | Tensor
    optima: Tensor
    starts: int | Tensor
    hits: int | Tensor
    iterations: int | Tensor
    converged: bool | Tensor

    @property
    def bound(self) -> float | Tensor:
        """The least of all certified bounds, which is `tight_bound`."""
        return self.tight_bound


@dataclass(frozen=True)
class AtRates:
    """The most that Ω → X → A earns with no more than given rates.

    Where `jump` is False there is one end, and all numbers are its own. Where it is True, they are
    means over ends that share the time, by a coin that both channels see; each end alone is optimal
    at the prices, and has other rates.

    Attributes:
        objective: What was maximised: E[U], less I/β of a channel that has a price.
        expected_utility: E[U(ω,a)], in utility units.
        perception_information: I(Ω;X) in nats, the budget or less, to about 10⁻⁵.
        action_information: I(X;A) in nats, likewise.
        beta_perception: Price β₁, per nat, at which an agent would choose this rate by itself;
            `inf` where more information would earn nothing; the given one if there is one.
        beta_action: Price β₂, per nat, likewise.
        upper_bound: No channels within the budgets, and no time sharing, have a larger objective.
        ends: Optima at these prices, one unless the rates jump.
        shares: Time that each has; they sum to one.
    """

    objective: float
    expected_utility: float
    perception_information: float
    action_information: float
    beta_perception: float
    beta_action: float
    upper_bound: float
    ends: tuple[Serial, ...]
    shares: tuple[float, ...]

    @property
    def jump(self) -> bool:
        """Whether no prices lead to these rates."""
        return len(self.ends) > 1


@dataclass(frozen=True)
class General(Serial):
    """Best optimum found of E[U] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) − (1/β₃) I(Ω;A|X).

    As `Serial`, with p(a|ω) = Σ p(x|ω) p(a|x,ω), p(a|x) = Σ p(ω|x) p(a|x,ω), and

    Attributes:
        direct_information: I(Ω;A|X) in nats.
        action_given_percept_and_state: p(a|x,ω), shape (..., X, W, A). The rows of a percept that
            is never used say nothing.
    """

    direct_information: float | Tensor
    action_given_percept_and_state: Tensor


def per_price(values: Tensor, shape: torch.Size) -> Any:
    """Values (B, ...) of B flattened prices as (*shape, ...); a Python number if only one is left.

    Args:
        values: One entry for each price, shape (B, ...).
        shape: Shape of the prices, () for one number.
    """
    shaped = values.reshape(shape + values.shape[1:])
    return shaped if shaped.ndim else shaped.item()


def warn_cap(solver: str, converged: Tensor, cap: str, gap: Tensor, depth: int = 0) -> None:
    """Warn, in the name of the solver's caller, about solves (B,) that were cut short, if any.

    Args:
        solver: Its name.
        converged: Whether a solve met its tolerance, (B,).
        cap: What cut it short.
        gap: Certified, (B,).
        depth: How many functions lie between the solver and this one.
    """
    cut_short = ~converged
    if cut_short.any():
        warnings.warn(
            f"{solver}: {int(cut_short.sum())} of {len(converged)} solves did not converge within "
            f"{cap}; the largest certified gap left is {gap[cut_short].max().item():.1e}",
            stacklevel=3 + depth,
        )
