"""The right-hand sides of the self-consistent equations, from log-probabilities."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from bra.chain import Chain
from bra.channels.distributions import log_normalise, normalise
from bra.marginals import posterior
from bra.objective import Objective, Price, sampled_objective

FLOOR = 1e-25
"""What an action that looks find useful may have at least in a percept, to come back from."""


@dataclass(frozen=True)
class Targets:
    """The right-hand sides of the self-consistent equations.

    Attributes:
        percept: p*(x|ξ), (B, X).
        action: p*(a|x), (X, A), or p*(a|x,ξ), (X, B, A).
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
    weight, percept, action = log_weight.exp(), log_percept.exp(), log_action.exp()
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_action).logsumexp(0)
    action_cost = divergence(action, log_action, log_action_marginal)
    utility_given = utilities @ action.T
    free_energy = utility_given - action_cost / beta_2

    utility = weight @ (percept * utility_given).sum(-1)
    perception_information = weight @ divergence(percept, log_percept, log_marginal)
    action_information = log_marginal.exp() @ action_cost
    costs = (perception_information, action_information)
    return Targets(
        percept=normalise(log_marginal + beta_1 * free_energy),
        action=normalise(log_action_marginal + beta_2 * value),
        terms=Objective(sampled_objective(utility, *costs, beta_1, beta_2), utility, *costs),
    )


def project_looks(
    chain: Chain,
    log_weight: Tensor,
    log_percept: Tensor,
    log_action: Tensor,
    log_marginal: Tensor,
    log_shared: Tensor,
    utilities: Tensor,
) -> Targets:
    """Targets for both channels where actions look at the signal again.

        p*(a|x,ξ) ∝ q(a|x) exp(β₃ [U(ω,a) − (1/β₂) log q(a|x)/q(a)])
        p*(x|ξ)   ∝ p(x) exp(β₁ ΔF),
        ΔF(ξ,x) = E_{p(a|x,ξ)}[U − (1/β₂) log p(a|x)/p(a) − (1/β₃) log p(a|x,ξ)/p(a|x)]

    q(a|x) is not p(a|x) but what looks make of it, see `after_looks`. At low β₃ the target that
    p(a|x) gives hardly differs from it: specialists would keep whatever prior a channel that does
    not fit exactly has let them drift to.

    Args:
        chain: Gives the prices.
        log_weight: log w(ξ), (B,).
        log_percept: log p(x|ξ), (B, X).
        log_action: log p(a|x,ξ), (X, B, A).
        log_marginal: log p(x), (X,).
        log_shared: log p(a|x), (X, A).
        utilities: U(ω,a), (B, A).
    """
    beta_1, beta_2, beta_3 = chain.beta_perception, chain.beta_action, chain.beta_direct
    assert beta_3 is not None  # or else there is nothing to look for
    useful = useful_action_price(chain)
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_shared).logsumexp(0)
    worth = _worth(log_shared, log_marginal, utilities, useful)
    action = log_action.exp()
    look = divergence(action, log_action, log_shared.unsqueeze(1))
    free_energy = ((action * worth).sum(-1) - look / beta_3).mT

    log_joint = log_weight.unsqueeze(-1) + log_percept
    given = posterior(log_joint, log_joint.logsumexp(0)).mT
    log_reach = (log_shared.unsqueeze(1) + beta_3 * worth).logsumexp(-1, keepdim=True)
    log_next = after_looks(log_shared, beta_3 * worth - log_reach, given, beta_3 / useful)
    next_worth = _worth(log_next, log_marginal, utilities, useful)

    joint = log_joint.exp()
    utility = (joint.mT * (action * utilities).sum(-1)).sum()
    of_percepts = divergence(log_percept.exp(), log_percept, log_marginal)
    of_actions = divergence(log_shared.exp(), log_shared, log_action_marginal)
    perception_information = log_weight.exp() @ of_percepts
    action_information = log_marginal.exp() @ of_actions
    direct = (joint.mT * look).sum()
    costs = (perception_information, action_information)
    objective = sampled_objective(utility, *costs, beta_1, beta_2, direct, beta_3)
    return Targets(
        percept=normalise(log_marginal + beta_1 * free_energy),
        action=normalise(log_next.unsqueeze(1) + beta_3 * next_worth),
        terms=Objective(objective, utility, *costs, direct),
    )


def after_looks(log_shared: Tensor, log_ratio: Tensor, given: Tensor, share: Price) -> Tensor:
    """Log p(a|x) after one more sweep, in which all look again, (…, X, A).

    The mean of p(a|x,ω) over the states of x exceeds p(a|x) by a factor D, and the closer β₃ is to
    0 the closer D is to 1. So log p(a|x) goes further by as much as the curvature of J allows, see
    `bra.blahut_arimoto.general_problem.GeneralProblem.sweep`.

    Args:
        log_shared: log p(a|x), (…, X, A).
        log_ratio: log p(a|x,ω)/p(a|x), the answer to it, (…, X, W, A).
        given: p(ω|x), (…, X, W).
        share: β₃/β₂, at most 1.
    """
    excess = log_ratio.expm1()
    smallest = torch.finfo(excess.dtype).eps - 1
    growth = (given.unsqueeze(-1) * excess).sum(-2).clamp(min=smallest).log1p()
    bend = -(given * excess.amin(-1)).sum(-1, keepdim=True)
    longest = 1 / growth.amax(-1, keepdim=True).clamp(min=FLOOR)
    length = (1 / (share + (1 - share) * bend)).minimum(longest).clamp(min=1.0)
    log_next = log_normalise(log_shared + length * growth)
    return log_normalise(log_next.clamp(min=math.log(FLOOR)))


def _worth(log_shared: Tensor, log_marginal: Tensor, utilities: Tensor, beta: Tensor) -> Tensor:
    """U(ω,a) − (1/β₂) log p(a|x)/p(a), (X, B, A)."""
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_shared).logsumexp(0)
    return utilities - (log_shared - log_action_marginal).unsqueeze(1) / beta


def useful_action_price(chain: Chain) -> Tensor:
    """β₂, or β₃ if that is higher, as a tensor ().

    Where 1/β₂ ≥ 1/β₃ percepts are worthless (see `bra.blahut_arimoto.general`), and just as
    worthless at 1/β₂ = 1/β₃. At higher prices the self-consistent equations hold, but do not
    attract.
    """
    beta_direct = chain.beta_direct
    assert beta_direct is not None  # as those who ask know
    return torch.maximum(torch.as_tensor(chain.beta_action), torch.as_tensor(beta_direct))


def divergence(p: Tensor, log_p: Tensor, log_q: Tensor) -> Tensor:
    """KL(p ‖ q) from logarithms, in nats; unlike from probabilities, finite at saturation.

    Args:
        p: (…, Y).
        log_p: (…, Y).
        log_q: (Y,), or broadcast against it.

    Returns:
        (…).
    """
    return torch.where(p > 0, p * (log_p - log_q), 0.0).sum(-1)


def cross_entropy(p: Tensor, log_q: Tensor) -> Tensor:
    """−Σ p log q, in nats; what p leaves out counts nothing, and has no gradient.

    Args:
        p: (…, Y).
        log_q: (…, Y).

    Returns:
        (…).
    """
    return -torch.where(p > 0, p * log_q, 0.0).sum(-1)
