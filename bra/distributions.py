"""What every part of the program asks of a `torch.distributions.Distribution`."""

from torch import Tensor
from torch.distributions import Categorical, Distribution, MixtureSameFamily


def probabilities(distribution: Distribution) -> Tensor:
    """Probability of every outcome.

    Args:
        distribution: One with enumerable support and batch shape (*batch,).

    Returns:
        (*batch, outcomes), in the order of the support.
    """
    if isinstance(distribution, Categorical):
        return distribution.probs
    support = distribution.enumerate_support(expand=False)
    return distribution.log_prob(support).exp().movedim(0, -1)


def log_probabilities(distribution: Distribution) -> Tensor:
    """Log-probability of every outcome: (*batch, outcomes), exact where probabilities underflow."""
    if isinstance(distribution, Categorical):
        return distribution.logits
    support = distribution.enumerate_support(expand=False)
    return distribution.log_prob(support).movedim(0, -1)


def mixture(weights: Tensor, components: Distribution) -> Distribution:
    """The marginal p(y) = Σ_k w_k p(y|k).

    Args:
        weights: (K,), summing to one.
        components: Distribution of batch shape (K,).

    Returns:
        Batch shape (): a `Categorical` if the components can be enumerated, a
        `MixtureSameFamily` otherwise.
    """
    if components.has_enumerate_support:
        return Categorical(probs=weights @ probabilities(components), validate_args=False)
    return MixtureSameFamily(
        Categorical(probs=weights, validate_args=False), components, validate_args=False
    )
