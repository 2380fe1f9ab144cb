"""Standard errors of J and its terms where they are estimated.

Every term is an expectation of some φ over signals ξ_i, percepts x_t and actions a_s of weights
w_i p(x_t|ξ_i) p(a_s|x_t), and is stationary in the marginals that φ holds. So to first order its
variance is that of a mean of φ over whatever was sampled: signals, and the supports of densities,
each by itself. Points of a support that follow each other lie in neighbouring strata, so that their
differences tell how a stratified sample scatters (von Neumann 1941): along the first dimension of
percepts or actions, and no less than the truth along others.
"""

from typing import Any

import torch
from torch import Tensor

from bra.chain import Chain
from bra.evaluation.shortfall import StratifiedSample
from bra.evaluation.tables import Tables
from bra.objective import Objective, sampled_objective

TINY = 1e-300
Means = tuple[Tensor, Tensor]


def standard_errors(
    chain: Chain,
    sample: StratifiedSample,
    tables: Tables,
    utilities: Tensor,
    found: Objective[Tensor],
) -> Objective[Tensor]:
    """One standard error of each term that was found.

    Args:
        chain: Gives the prices.
        sample: How the N signals were sampled.
        tables: The channels over signals and supports.
        utilities: U(ω_i, a_s), (N, A).
        found: Says which terms there are.
    """
    percepts, behaviour = tables.percept_given_signal, tables.action_given_signal
    percept, action = sample.weights @ percepts, sample.weights @ behaviour
    takes, states = _log_ratio(percepts, percept), sample.of_signals(behaviour)
    responses = _Responses(sample.weights, tables)
    acts = responses.of_pairs(_log_ratio(tables.action_given_percept, action))
    looks: Means | tuple[None, None] = (None, None)
    if tables.second_look is not None:
        ratio = _log_ratio(tables.second_look, tables.action_given_percept.unsqueeze(1))
        looks = responses.over_actions(ratio)
    utility = responses.over_actions(utilities)
    beta_1, beta_2, beta_3 = chain.beta_perception, chain.beta_action, chain.beta_direct
    nothing = torch.zeros_like(takes[:1, :1])
    objective = tuple(
        sampled_objective(earned, spent, own, beta_1, beta_2, look, beta_3)
        for earned, spent, own, look in zip(utility, (takes, nothing), acts, looks, strict=True)
    )
    parts: dict[str, Any] = {
        "objective": objective,
        "expected_utility": utility,
        "perception_information": (takes, None),
        "action_information": acts,
        "direct_information": looks,
        "end_to_end_information": responses.over_actions(_log_ratio(states, action)),
        "state_information": (_log_ratio(sample.of_signals(percepts), percept), None),
        "signal_action_information": responses.over_actions(_log_ratio(behaviour, action)),
    }

    def error(of_percepts: Tensor, of_actions: Tensor | None) -> Tensor:
        variance: Tensor = sample.variance((percepts * of_percepts).sum(-1))
        if not tables.enumerable_percepts:
            variance = variance + _of_support(sample.weights, percepts, of_percepts)
        if of_actions is not None and not tables.enumerable_actions:
            variance = variance + responses.variance(of_actions)
        return variance.sqrt()

    return Objective(**{name: error(*parts[name]) for name in found.known()})


class _Responses:
    """What actions make of a function φ: its means over actions, which percepts and signals have.

    Args:
        weights: w_i of the signals, (N,).
        tables: The channels.
    """

    def __init__(self, weights: Tensor, tables: Tables) -> None:
        self._joint = (weights[:, None] * tables.percept_given_signal).mT  # (X, N)
        self._actions, self._look = tables.action_given_percept, tables.second_look

    def over_actions(self, values: Tensor) -> Means:
        """Of φ(ξ,a), (N, A), or φ(x,ξ,a), (X, N, A), the mean over actions, (N, X).

        And φ as far as a condition of the action channel knows it: over signals, (X, A), or itself,
        (X, N, A), where actions look at the signal again.
        """
        if self._look is not None:
            return (self._look * values).sum(-1).mT, values.expand_as(self._look)
        posterior = self._joint / self._joint.sum(1, keepdim=True).clamp_min(TINY)
        return values @ self._actions.T, posterior @ values

    def of_pairs(self, values: Tensor) -> Means:
        """The same of φ(x,a), (X, A)."""
        if self._look is not None:
            return self.over_actions(values.unsqueeze(1))
        return (self._actions * values).sum(-1).expand_as(self._joint.T), values

    def variance(self, values: Tensor) -> Tensor:
        """Of the mean of φ over a sampled support of actions, as `over_actions` has it."""
        if self._look is None:
            return _of_support(self._joint.sum(1), self._actions, values)
        flat = (self._joint.flatten(), self._look.flatten(0, 1), values.flatten(0, 1))
        return _of_support(*flat)


def _of_support(weights: Tensor, table: Tensor, values: Tensor) -> Tensor:
    """Variance of Σ_c w_c Σ_y p(y|c) φ(c, y) over Y sampled points y, rows normalised.

    Args:
        weights: w_c, (C,).
        table: p(y|c), (C, Y).
        values: φ, (C, Y).
    """
    means = torch.einsum("cy,cy->c", table, values)
    parts = weights @ (table * values) - (weights * means) @ table
    return parts.diff().square().sum() / 2


def _log_ratio(rows: Tensor, marginal: Tensor) -> Tensor:
    """The logarithm of p(y|c)/p(y), (C, Y); 0 where p(y|c) is."""
    return torch.where(rows > 0, rows.clamp_min(TINY) / marginal.clamp_min(TINY), 1.0).log()
