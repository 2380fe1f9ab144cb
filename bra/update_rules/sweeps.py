"""Sweeps of the self-consistent equations over tables, from log-probabilities."""

from typing import NamedTuple

from torch import Tensor

from bra.chain import Chain
from bra.channels.distributions import log_normalise
from bra.marginals import posterior
from bra.objective import Price
from bra.update_rules.targets import after_looks, divergence, useful_action_price


class Sweep(NamedTuple):
    """What one sweep of the self-consistent equations makes of p(a|x) and p(x).

    The batch shape is that of what it was given.

    Attributes:
        log_percept: log p(x|ω), the answer to the old p(a|x) and p(x), (…, W, X).
        log_action: log p(a|x), the answer to that, (…, X, A).
        log_marginal: log p(x) = log Σ_ω p(ω) p(x|ω), (…, X).
        objective: J of p(x|ω), the old p(a|x) and marginals; the new ones have no less, (…).
        log_look: log p(a|x,ω), the answer to the old p(a|x), where actions look at the state again,
            (…, X, W, A).
    """

    log_percept: Tensor
    log_action: Tensor
    log_marginal: Tensor
    objective: Tensor
    log_look: Tensor | None = None


def sweep(
    log_action: Tensor,
    log_marginal: Tensor,
    log_weight: Tensor,
    utilities: Tensor,
    beta_perception: Price,
    beta_action: Price,
) -> Sweep:
    """One sweep: p(x|ω) from p(a|x) and p(x), then p(a|x) and p(x) from p(x|ω).

    Each step maximises J in one argument with the others held, so J never falls (Genewein,
    Leibfried, Grau-Moya & Braun 2015, section 4). With the first, J is (1/β₁) Σ_ω p(ω) log Z(ω),
    Z(ω) = Σ_x p(x) exp(β₁ ΔF(ω,x)).

    Args:
        log_action: log p(a|x), (…, X, A).
        log_marginal: log p(x), (…, X).
        log_weight: log p(ω), (W,).
        utilities: U(ω,a), (W, A).
        beta_perception: β₁.
        beta_action: β₂.
    """
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_action).logsumexp(-2, keepdim=True)
    action = log_action.exp()
    cost = divergence(action, log_action, log_action_marginal) / beta_action
    free_energy = utilities @ action.mT - cost.unsqueeze(-2)
    logits = log_marginal.unsqueeze(-2) + beta_perception * free_energy
    log_partition = logits.logsumexp(-1, keepdim=True)
    log_percept = logits - log_partition
    log_joint = log_weight.unsqueeze(-1) + log_percept
    new_marginal = log_joint.logsumexp(-2)
    value = posterior(log_joint, new_marginal).mT @ utilities
    return Sweep(
        log_percept,
        log_normalise(log_action_marginal + beta_action * value),
        new_marginal,
        log_partition.squeeze(-1) @ log_weight.exp() / beta_perception,
    )


def sweep_looks(
    log_action: Tensor,
    log_marginal: Tensor,
    log_weight: Tensor,
    utilities: Tensor,
    beta_perception: Price,
    beta_action: Price,
    beta_direct: Price,
) -> Sweep:
    """The same where actions look at the state again: p(a|x,ω) and p(x|ω), then p(a|x) and p(x).

    Args:
        log_action: log p(a|x), (…, X, A).
        log_marginal: log p(x), (…, X).
        log_weight: log p(ω), (W,).
        utilities: U(ω,a), (W, A).
        beta_perception: β₁.
        beta_action: β₂, at least β₃.
        beta_direct: β₃.
    """
    log_action_marginal = (log_marginal.unsqueeze(-1) + log_action).logsumexp(-2, keepdim=True)
    cost = (log_action - log_action_marginal) / beta_action
    gain = beta_direct * (utilities - cost.unsqueeze(-2))  # (…, X, W, A)
    log_look = log_action.unsqueeze(-2) + gain
    log_reach = log_look.logsumexp(-1, keepdim=True)
    logits = log_marginal.unsqueeze(-2) + beta_perception / beta_direct * log_reach.squeeze(-1).mT
    log_partition = logits.logsumexp(-1, keepdim=True)
    log_percept = logits - log_partition
    log_joint = log_weight.unsqueeze(-1) + log_percept
    new_marginal = log_joint.logsumexp(-2)
    given = posterior(log_joint, new_marginal).mT
    share = beta_direct / beta_action
    return Sweep(
        log_percept,
        after_looks(log_action, gain - log_reach, given, share),
        new_marginal,
        log_partition.squeeze(-1) @ log_weight.exp() / beta_perception,
        log_look - log_reach,
    )


def sweep_chain(
    chain: Chain, log_action: Tensor, log_marginal: Tensor, log_weight: Tensor, utilities: Tensor
) -> Sweep:
    """The sweep that goes with a chain's prices; arguments as those of `sweep`."""
    tables = (log_action, log_marginal, log_weight, utilities)
    if chain.beta_direct is None:
        return sweep(*tables, chain.beta_perception, chain.beta_action)
    prices = (chain.beta_perception, useful_action_price(chain), chain.beta_direct)
    return sweep_looks(*tables, *prices)
