"""The terms of J = E[U] − I(Ω;X)/β₁ − I(X;A)/β₂, per sample and in expectation."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from torch import Tensor

from bra.information import mutual_information

Price = float | Tensor
"""β, per nat: a number, or a tensor of shape () where agents are trained as one batch."""

Number = TypeVar("Number", float, Tensor)
Other = TypeVar("Other", float, Tensor)


@dataclass(frozen=True)
class Objective(Generic[Number]):
    """J and its terms; information in nats.

    Attributes:
        objective: J.
        expected_utility: E[U(ω, a)].
        perception_information: I(ξ;X), which is I(Ω;X) where the sensor is noiseless.
        action_information: I(X;A).
        direct_information: I(ξ;A|X), which is I(Ω;A|X) where the sensor is noiseless, of actions
            that look at the signal again, else None.
        end_to_end_information: I(Ω;A); None where the states are not known, or it was not computed.
        state_information: I(Ω;X) where states are known and the sensor is noisy, else None.
        signal_action_information: I(ξ;A) where the states are not known, else None.
        standard_error: One standard error of J where it is estimated, else None.
    """

    objective: Number
    expected_utility: Number
    perception_information: Number
    action_information: Number
    direct_information: Number | None = None
    end_to_end_information: Number | None = None
    state_information: Number | None = None
    signal_action_information: Number | None = None
    standard_error: Number | None = None

    def detach(self: "Objective[Tensor]") -> "Objective[Tensor]":
        """The same without the graph that it was computed by."""
        return self.map(Tensor.detach)

    def item(self: "Objective[Tensor]") -> "Objective[float]":
        """The same with Python floats."""
        return self.map(Tensor.item)

    def map(self, change: Callable[[Number], Other]) -> "Objective[Other]":
        """The same with every term changed."""
        return Objective(**{name: change(value) for name, value in self.known().items()})

    def raised(self, by: Number) -> "Objective[Number]":
        """The same if all utilities were higher by so much."""
        return replace(
            self, objective=self.objective + by, expected_utility=self.expected_utility + by
        )

    def known(self) -> dict[str, Number]:
        """What was computed, by the name of its attribute."""
        return {name: value for name, value in vars(self).items() if value is not None}


@dataclass(frozen=True)
class Term:
    """How a term of J is called where people meet it.

    Attributes:
        symbol: In tables and figures.
        tag: In loggers, where information is in bits.
        key: In JSON and CSV, where it is in nats.
    """

    symbol: str
    tag: str
    key: str

    @property
    def in_bits(self) -> bool:
        """Whether people are shown bits."""
        return self.tag.endswith("_bits")

    def shown(self, value: float) -> float:
        """The value as loggers and tables have it."""
        return bits(value) if self.in_bits else value


TERMS = {
    "objective": Term("J", "objective/J", "objective"),
    "expected_utility": Term("E[U]", "objective/expected_utility", "expected_utility"),
    "perception_information": Term(
        "I(ξ;X)", "information/perception_bits", "perception_information_nats"
    ),
    "state_information": Term("I(Ω;X)", "information/state_bits", "state_information_nats"),
    "action_information": Term("I(X;A)", "information/action_bits", "action_information_nats"),
    "direct_information": Term("I(Ω;A|X)", "information/direct_bits", "direct_information_nats"),
    "end_to_end_information": Term(
        "I(Ω;A)", "information/end_to_end_bits", "end_to_end_information_nats"
    ),
    "signal_action_information": Term(
        "I(ξ;A)", "information/signal_action_bits", "signal_action_information_nats"
    ),
}
"""The names of the terms of J, by attribute of `Objective`."""


def bits(nats: float) -> float:
    """Information in bits, for display: nats / ln 2."""
    return nats / math.log(2)


def digits(value: float, error: float | None = None) -> str:
    """A number for people: to five places, or with its error to one digit, and no further."""
    if not error or error < 1e-5:
        return f"{value:.5f}"
    places = max(0, -math.floor(math.log10(error)))
    return f"{value:.{places}f} ± {error:.{places}f}"


def logged(objective: Objective[float], group: str | None = None) -> dict[str, float]:
    """J and its terms under their tags, information in bits; all in one group if it is given."""
    known = objective.known()
    found = {t.tag: t.shown(known[name]) for name, t in TERMS.items() if name in known}
    if group is None:
        return found
    return {f"{group}/{tag.rpartition('/')[2]}": value for tag, value in found.items()}


def saved(objective: Objective[float]) -> dict[str, float | None]:
    """J and its terms under their keys in files, information in nats; None for unknown ones."""
    return {term.key: getattr(objective, name) for name, term in TERMS.items()}


def finite(beta: float) -> float | None:
    """An inverse price as files have it, None where information is free: JSON knows no inf."""
    return beta if beta < math.inf else None


def sampled_objective(
    utility: Tensor,
    perception_cost: Tensor,
    action_cost: Tensor,
    beta_perception: Price,
    beta_action: Price,
    direct_cost: Tensor | None = None,
    beta_direct: Price | None = None,
) -> Tensor:
    """j(ω, x, a) = U(ω, a) − (1/β₁) log p(x|ξ)/p(x) − (1/β₂) log p(a|x)/p(a), so that J = E[j].

    Where actions look at the signal again, less (1/β₃) log p(a|x,ξ)/p(a|x).

    Args:
        utility: U(ω, a), (*batch,).
        perception_cost: log p(x|ξ)/p(x), (*batch,), nats.
        action_cost: log p(a|x)/p(a), (*batch,), nats.
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        direct_cost: log p(a|x,ξ)/p(a|x), (*batch,), nats; None where actions do not look again.
        beta_direct: β₃, per nat.

    Returns:
        (*batch,).
    """
    j = utility - perception_cost / beta_perception - action_cost / beta_action
    return j if direct_cost is None or beta_direct is None else j - direct_cost / beta_direct


def table_objective(
    prior: Tensor,
    percept_given_state: Tensor,
    action_given_percept: Tensor,
    utilities: Tensor,
    beta_perception: Price,
    beta_action: Price,
    beta_direct: Price | None = None,
) -> Objective[Tensor]:
    """J by enumeration; differentiable, also through the marginals.

    J = Σ p(ω) p(x|ω) p(a|x) [U(ω,a) − (1/β₁) log p(x|ω)/p(x) − (1/β₂) log p(a|x)/p(a)]
    with p(x) = Σ_ω p(ω) p(x|ω) and p(a) = Σ_x p(x) p(a|x). Where actions look again, p(a|x) is the
    mean of p(a|x,ω) over the states of x, and J is less by I(Ω;A|X)/β₃.

    Args:
        prior: p(ω), (W,).
        percept_given_state: p(x|ω), (W, X).
        action_given_percept: p(a|x), (X, A), or p(a|x,ω), (X, W, A).
        utilities: U(ω, a), (W, A).
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
        beta_direct: β₃, per nat, for p(a|x,ω).
    """
    direct = None
    if beta_direct is None:
        action_given_state = percept_given_state @ action_given_percept
    else:
        action_given_state = torch.einsum("wx,xwa->wa", percept_given_state, action_given_percept)
        joint = prior.unsqueeze(-1) * percept_given_state
        action_given_percept, direct = shared_part(joint, action_given_percept)
    expected_utility = torch.einsum("w,wa,wa->", prior, action_given_state, utilities)
    perception_information = mutual_information(prior, percept_given_state)
    action_information = mutual_information(prior @ percept_given_state, action_given_percept)
    costs = (perception_information, action_information)
    prices = (beta_perception, beta_action)
    return Objective(
        objective=sampled_objective(expected_utility, *costs, *prices, direct, beta_direct),
        expected_utility=expected_utility,
        perception_information=perception_information,
        action_information=action_information,
        direct_information=direct,
        end_to_end_information=mutual_information(prior, action_given_state),
    )


def shared_part(joint: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """p(a|x) = Σ_ω p(ω|x) p(a|x,ω), (X, A), and I(Ω;A|X), nats, ().

    Args:
        joint: p(ω,x), (W, X).
        action: p(a|x,ω), (X, W, A).
    """
    percept = joint.sum(0)
    posterior = (joint / percept.clamp(min=torch.finfo(joint.dtype).tiny)).mT
    mean = torch.einsum("xw,xwa->xa", posterior, action)
    return mean, percept @ mutual_information(posterior, action)
