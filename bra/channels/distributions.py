"""What every part of the program asks of a `torch.distributions.Distribution`."""

from typing import ClassVar

import torch
from torch import Tensor
from torch.distributions import Categorical, Distribution, MixtureSameFamily
from torch.distributions.constraints import Constraint

from bra.randomness.draws import UniformNumbers


def probabilities(distribution: Distribution) -> Tensor:
    """Probability of every outcome.

    Args:
        distribution: One with enumerable support and batch shape (*batch,).

    Returns:
        (*batch, outcomes), in the order of the support.
    """
    if isinstance(distribution, Categorical) and "logits" in vars(distribution):
        return distribution.logits.exp()  # normalised; probs would normalise them once more
    if isinstance(distribution, Categorical | Marginal):
        return distribution.probs
    support = distribution.enumerate_support(expand=False)
    return distribution.log_prob(support).exp().movedim(0, -1)


def log_probabilities(distribution: Distribution) -> Tensor:
    """Log-probability of every outcome, in nats, to full precision also where it saturates.

    Args:
        distribution: One with enumerable support and batch shape (*batch,).

    Returns:
        (*batch, outcomes), in the order of the support.
    """
    if isinstance(distribution, Categorical):
        return distribution.logits
    support = distribution.enumerate_support(expand=False)
    return distribution.log_prob(support).movedim(0, -1)


def draw(
    distribution: Distribution,
    shape: tuple[int, ...] = (),
    uniform: UniformNumbers = torch.rand,
) -> Tensor:
    """Draws outcomes, (*shape, *batch shape, *event shape).

    Where outcomes can be enumerated, by the inverse of the distribution function: the first
    outcome whose cumulated probability exceeds a uniform number, one number per draw. Outcomes
    without probability are never drawn. Otherwise by the distribution's own sampling.

    Args:
        distribution: What to draw from.
        shape: Of the draws.
        uniform: Makes numbers in [0, 1), called like `torch.rand`.
    """
    if not distribution.has_enumerate_support:
        return distribution.sample(torch.Size(shape))
    cumulated = probabilities(distribution).detach().cumsum(-1)
    numbers = uniform(
        (*shape, *distribution.batch_shape), dtype=cumulated.dtype, device=cumulated.device
    )
    # Cumulated probabilities may round to something else than 1 in the end.
    thresholds = (numbers * cumulated[..., -1]).unsqueeze(-1)
    index = (cumulated <= thresholds).sum(-1)
    if isinstance(distribution, Categorical):
        return index
    return distribution.enumerate_support(expand=False).flatten()[index]


class Marginal(Distribution):
    """A distribution p(y) over finitely many outcomes, batch shape (), to score under.

    `Categorical` would first normalise and broadcast, which is half of the work of scoring, and
    every update scores under two marginals.

    Args:
        probs: (Y,), summing to one.
    """

    arg_constraints: ClassVar[dict[str, Constraint]] = {}
    has_enumerate_support = True

    def __init__(self, probs: Tensor) -> None:
        super().__init__(validate_args=False)
        self.probs = probs

    def enumerate_support(self, expand: bool = True) -> Tensor:
        """All outcomes, (Y,)."""
        return torch.arange(len(self.probs), device=self.probs.device)

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
