"""The terms of J = E[U] − I(Ω;X)/β₁ − I(X;A)/β₂, per sample and in expectation."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
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
        end_to_end_information: I(Ω;A) where the states are known, else I(ξ;A); None where it was
            not computed.
        state_information: I(Ω;X) where states are known and the sensor is noisy, else None.
    """

    objective: Number
    expected_utility: Number
    perception_information: Number
    action_information: Number
    end_to_end_information: Number | None = None
    state_information: Number | None = None

    def detach(self: "Objective[Tensor]") -> "Objective[Tensor]":
        """The same without the graph that it was computed by."""
        return self._map(Tensor.detach)

    def item(self: "Objective[Tensor]") -> "Objective[float]":
        """The same with Python floats."""
        return self._map(Tensor.item)

    def _map(self, change: Callable[[Number], Other]) -> "Objective[Other]":
        values = (getattr(self, field.name) for field in fields(self))
        return Objective(*(None if value is None else change(value) for value in values))  # type: ignore[arg-type]  # None stays where it is allowed


def bits(nats: float) -> float:
    """Information in bits, for display: nats / ln 2."""
    return nats / math.log(2)


def evaluation_metrics(objective: Objective[float]) -> dict[str, float]:
    """J and its terms under their logged names, information in bits."""
    information = {
        "perception": objective.perception_information,
        "state": objective.state_information,
        "action": objective.action_information,
        "end_to_end": objective.end_to_end_information,
    }
    return {
        "objective/J": objective.objective,
        "objective/expected_utility": objective.expected_utility,
    } | {
        f"information/{name}_bits": bits(nats)
        for name, nats in information.items()
        if nats is not None
    }


def sampled_objective(
    utility: Tensor,
    perception_cost: Tensor,
    action_cost: Tensor,
    beta_perception: Price,
    beta_action: Price,
) -> Tensor:
    """j(ω, x, a) = U(ω, a) − (1/β₁) log p(x|ξ)/p(x) − (1/β₂) log p(a|x)/p(a), so that J = E[j].

    Args:
        utility: U(ω, a), (*batch,).
        perception_cost: log p(x|ξ)/p(x), (*batch,), nats.
        action_cost: log p(a|x)/p(a), (*batch,), nats.
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.

    Returns:
        (*batch,).
    """
    return utility - perception_cost / beta_perception - action_cost / beta_action


def table_objective(
    prior: Tensor,
    percept_given_state: Tensor,
    action_given_percept: Tensor,
    utilities: Tensor,
    beta_perception: Price,
    beta_action: Price,
) -> Objective[Tensor]:
    """J by enumeration; differentiable, also through the marginals.

    J = Σ p(ω) p(x|ω) p(a|x) [U(ω,a) − (1/β₁) log p(x|ω)/p(x) − (1/β₂) log p(a|x)/p(a)]
    with p(x) = Σ_ω p(ω) p(x|ω) and p(a) = Σ_x p(x) p(a|x).

    Args:
        prior: p(ω), (W,).
        percept_given_state: p(x|ω), (W, X).
        action_given_percept: p(a|x), (X, A).
        utilities: U(ω, a), (W, A).
        beta_perception: β₁, per nat.
        beta_action: β₂, per nat.
    """
    action_given_state = percept_given_state @ action_given_percept
    expected_utility = torch.einsum("w,wa,wa->", prior, action_given_state, utilities)
    perception_information = mutual_information(prior, percept_given_state)
    action_information = mutual_information(prior @ percept_given_state, action_given_percept)
    return Objective(
        objective=sampled_objective(
            expected_utility,
            perception_information,
            action_information,
            beta_perception,
            beta_action,
        ),
        expected_utility=expected_utility,
        perception_information=perception_information,
        action_information=action_information,
        end_to_end_information=mutual_information(prior, action_given_state),
    )
