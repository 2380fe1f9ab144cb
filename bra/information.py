"""Entropy, Kullback-Leibler divergence and mutual information of finite distributions.

Everything is in nats; divide by ln 2 for bits. The functions take probabilities, not logits,
broadcast over leading batch dimensions, keep the dtype, and read 0 log 0 as 0. Where a
probability is zero, gradients are finite: the term's own derivative, which would be infinite, is
taken as zero.
"""

import torch
from torch import Tensor


def entropy(probabilities: Tensor) -> Tensor:
    """Shannon entropy H(p) = −Σ p log p, in nats.

    Args:
        probabilities: Distributions over the last dimension, shape (..., X).

    Returns:
        Entropies, shape (...).
    """
    return -(probabilities * _log_where_positive(probabilities)).sum(-1)


def kl_divergence(p: Tensor, q: Tensor) -> Tensor:
    """Kullback-Leibler divergence KL(p ‖ q) = Σ p log(p/q), in nats.

    Infinite where p has mass that q has not.

    Args:
        p: Distributions over the last dimension, shape (..., X).
        q: Distributions over the last dimension, shape (..., X), broadcast against `p`.

    Returns:
        Divergences, shape (...).
    """
    return _divergence_terms(p, q).sum(-1)


def mutual_information(prior: Tensor, conditional: Tensor) -> Tensor:
    """Mutual information I(W;X) = Σ p(w) KL(p(x|w) ‖ p(x)) with p(x) = Σ p(w) p(x|w), in nats.

    A condition without mass contributes nothing, whatever its row holds.

    Args:
        prior: p(w), shape (..., W).
        conditional: p(x|w), rows sum to one, shape (..., W, X).

    Returns:
        Information, shape (...).
    """
    marginal = torch.einsum("...w,...wx->...x", prior, conditional).unsqueeze(-2)
    # Outcomes without mass belong to conditions without mass only; their infinite terms would
    # turn 0 · ∞ into NaN.
    reachable = torch.where(marginal > 0, conditional, torch.zeros_like(conditional))
    return (prior * _divergence_terms(reachable, marginal).sum(-1)).sum(-1)


def _divergence_terms(p: Tensor, q: Tensor) -> Tensor:
    """Terms p log(p/q) − p + q, none of them negative.

    For distributions −p + q sums to zero. It is kept because a divergence is second order in
    p − q: near p = q the bare terms p log(p/q) are first order and their sum drowns in rounding.
    """
    return p * _log_ratio(p, q) - (p - q)


def _log_ratio(p: Tensor, q: Tensor) -> Tensor:
    """log(p/q), to full relative precision also for p near q; 0 where p = 0."""
    near = (p - q).abs() < q / 2
    excess = torch.where(near, (p - q) / torch.where(near, q, torch.ones_like(q)), 0.0)
    # p > 0 = q is +∞ and must stay so; p = 0 is a zero term whatever q is.
    log_q = torch.where(p > 0, q, torch.ones_like(q)).log()
    return torch.where(near, excess.log1p(), _log_where_positive(p) - log_q)


def _log_where_positive(p: Tensor) -> Tensor:
    """Logarithm where p > 0, else 0, with gradient zero there."""
    return torch.where(p > 0, p, torch.ones_like(p)).log()
