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


class Marginal(Categorical):
    """A `Categorical` of batch shape () from probabilities that already sum to one.

    Normalising and broadcasting, which `Categorical` does, would be half of the work of scoring
    under a marginal, and every update does it twice.
    """

    def __init__(self, probs: Tensor) -> None:
        self.probs = probs
        self._param = probs
        self._num_events = probs.shape[-1]
        Distribution.__init__(self, validate_args=False)

    def log_prob(self, value: Tensor) -> Tensor:
        """Returns log p(y), the shape of `value`."""
        return self.probs[value].log()


def mixture(weights: Tensor, components: Distribution) -> Distribution:
    """The marginal p(y) = Σ_k w_k p(y|k).

    Args:
        weights: (K,), summing to one.
        components: Distribution of batch shape (K,).

    Returns:
        Batch shape (): a `Marginal` if the components can be enumerated, a
        `MixtureSameFamily` otherwise.
    """
    if components.has_enumerate_support:
        return Marginal(weights @ probabilities(components))
    return MixtureSameFamily(
        Categorical(probs=weights, validate_args=False), components, validate_args=False
    )
