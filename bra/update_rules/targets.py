"""The right-hand sides of the self-consistent equations, from log-probabilities."""

from dataclasses import dataclass

import torch
from torch import Tensor

from bra.chain import Chain
from bra.objective import Objective, sampled_objective


@dataclass(frozen=True)
class Targets:
    """The right-hand sides of the self-consistent equations.

    Attributes:
        percept: p*(x|ξ), (B, X).
        action: p*(a|x), (X, A).
        terms: J and its terms at the current channels, not at the targets.
    """

    percept: Tensor
    action: Tensor
    terms: Objective[Tensor]


def project(
    chain: Chain,
    log_weight: Tensor,
    log_percept: Tensor,
    log_action: Tensor,
    log_marginal: Tensor,
    utilities: Tensor,
    value: Tensor,
) -> Targets:
    """Targets for both channels, from logarithms and so to full precision at saturation.

    Args:
        chain: Gives the prices.
        log_weight: log w(ξ), (B,).
        log_percept: log p(x|ξ), (B, X).
        log_action: log p(a|x), (X, A).
        log_marginal: log p(x), (X,).
        utilities: U(ω,a), (B, A).
        value: E[U(ω,a)|x], (X, A).
    """
    beta_1, beta_2 = chain.beta_perception, chain.beta_action
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_action).logsumexp(0)
    action_cost = divergence(log_action, log_action_marginal)
    utility_given = utilities @ log_action.exp().T
    free_energy = utility_given - action_cost / beta_2

    utility = log_weight.exp() @ (log_percept.exp() * utility_given).sum(-1)
    perception_information = log_weight.exp() @ divergence(log_percept, log_marginal)
    action_information = log_marginal.exp() @ action_cost
    costs = (perception_information, action_information)
    return Targets(
        percept=(log_marginal + beta_1 * free_energy).softmax(-1),
        action=(log_action_marginal + beta_2 * value).softmax(-1),
        terms=Objective(sampled_objective(utility, *costs, beta_1, beta_2), utility, *costs),
    )


def divergence(log_p: Tensor, log_q: Tensor) -> Tensor:
    """KL(p ‖ q) from logarithms, in nats; unlike from probabilities, finite at saturation.

    Args:
        log_p: (…, Y).
        log_q: (Y,).

    Returns:
        (…).
    """
    p = log_p.exp()
    return torch.where(p > 0, p * (log_p - log_q), 0.0).sum(-1)
