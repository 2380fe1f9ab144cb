"""Standard errors of J and its terms where they are estimated.

Every term is an expectation of some φ over signals ξ_i, percepts x_t and actions a_s of weights
w_i p(x_t|ξ_i) p(a_s|x_t), and is stationary in the marginals that φ holds. So to first order its
variance is that of a mean of φ over whatever was sampled: signals, and the supports of densities,
each by itself. That supports are stratified is left aside, so that their part is no less than the
truth.
"""

import torch
from torch import Tensor

from bra.chain import Chain
from bra.evaluation.shortfall import StratifiedSample
from bra.evaluation.tables import Tables
from bra.objective import Objective, sampled_objective

TINY = 1e-300


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
    percepts, actions = tables.percept_given_signal, tables.action_given_percept
    behaviour = tables.action_given_signal
    percept, action = sample.weights @ percepts, sample.weights @ behaviour
    joint = (sample.weights[:, None] * percepts).T
    posterior = joint / percept.clamp_min(TINY)[:, None]
    takes, acts = _log_ratio(percepts, percept), _log_ratio(actions, action)

    def over_actions(values: Tensor) -> tuple[Tensor, Tensor]:
        """φ(ξ, a), (N, A), in the mean over actions, (N, X), and over signals, (X, A)."""
        return values @ actions.T, posterior @ values

    utility = over_actions(utilities)
    cost = (actions * acts).sum(-1)
    beta_1, beta_2 = chain.beta_perception, chain.beta_action
    states = sample.of_signals(behaviour)
    parts = {
        "objective": (
            sampled_objective(utility[0], takes, cost, beta_1, beta_2),
            utility[1] - acts / beta_2,
        ),
        "expected_utility": utility,
        "perception_information": (takes, None),
        "action_information": (cost.expand_as(takes), acts),
        "end_to_end_information": over_actions(_log_ratio(states, action)),
        "state_information": (
            _log_ratio(sample.of_signals(percepts), percept),
            None,
        ),
        "signal_action_information": over_actions(_log_ratio(behaviour, action)),
    }

    def error(of_percepts: Tensor, of_actions: Tensor | None) -> Tensor:
        variance: Tensor = sample.variance((percepts * of_percepts).sum(-1))
        if not tables.enumerable_percepts:
            variance = variance + _of_support(sample.weights, percepts, of_percepts)
        if of_actions is not None and not tables.enumerable_actions:
            variance = variance + _of_support(percept, actions, of_actions)
        return variance.sqrt()

    return Objective(**{name: error(*parts[name]) for name in found.known()})


def _of_support(weights: Tensor, table: Tensor, values: Tensor) -> Tensor:
    """Variance of Σ_c w_c Σ_y p(y|c) φ(c, y) over Y sampled points y, rows normalised.

    Args:
        weights: w_c, (C,).
        table: p(y|c), (C, Y).
        values: φ, (C, Y).
    """
    means = torch.einsum("cy,cy->c", table, values)
    return (weights @ (table * values) - (weights * means) @ table).square().sum()


def _log_ratio(rows: Tensor, marginal: Tensor) -> Tensor:
    """The logarithm of p(y|c)/p(y), (C, Y); 0 where p(y|c) is."""
    return torch.where(rows > 0, rows.clamp_min(TINY) / marginal.clamp_min(TINY), 1.0).log()
