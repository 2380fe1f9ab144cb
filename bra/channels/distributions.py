"""What every part of the program asks of a `torch.distributions.Distribution`."""

from typing import Any, Self

import torch
from torch import Tensor, distributions
from torch._C._functorch import is_functorch_wrapped_tensor
from torch.distributions import Distribution, MixtureSameFamily
from torch.distributions.utils import lazy_property

from bra.randomness.draws import UniformNumbers

FEW = 1024
"""Logits whose softmax takes no longer than operations of torch take in any case."""


class Categorical(distributions.Categorical):
    """Torch's, with probabilities and log-probabilities that are both made from what is given.

    Torch's makes log-probabilities from clamped probabilities. Here logits x give log p by
    `log_normalise`, and probabilities are taken as they are.

    Args:
        probs: (*batch, Y), summing to one.
        logits: (*batch, Y), in place of `probs`.
        validate_args: Whether to look for numbers that cannot be, which does not run under `vmap`.
    """

    _of_logits = False

    def __init__(
        self,
        probs: Tensor | None = None,
        logits: Tensor | None = None,
        validate_args: bool | None = False,
    ) -> None:
        if (probs is None) == (logits is None):
            raise ValueError("Categorical needs either probs or logits")
        if logits is not None:
            self._param, self.logits, self._of_logits = logits, log_normalise(logits), True
        elif probs is not None:
            self._param, self.probs = probs, probs
        self._num_events = self._param.shape[-1]
        Distribution.__init__(self, self._param.shape[:-1], validate_args=validate_args)

    @lazy_property
    def logits(self) -> Tensor:
        """Log-probabilities, (*batch, Y)."""
        return self._param.log()

    @lazy_property
    def probs(self) -> Tensor:
        """Probabilities, (*batch, Y)."""
        return self.logits.exp()

    def double(self) -> "Categorical":
        """The same in float64, normalised there; without a gradient."""
        given = self._param.detach().double()
        return Categorical(logits=given) if self._of_logits else Categorical(given)

    def log_prob(self, value: Tensor) -> Tensor:
        """Returns log p(y), the shape of `value` if the batch shape is ()."""
        if not self.batch_shape:
            return self.logits[value]
        scores: Tensor = super().log_prob(value)  # type: ignore[no-untyped-call]
        return scores

    def expand(
        self, batch_shape: torch.Size | list[int] | tuple[int, ...], _instance: Any = None
    ) -> Self:
        """The same for more conditions; see `torch.distributions.Distribution.expand`."""
        wider = _instance or type(self).__new__(type(self))
        expanded: Self = super().expand(batch_shape, wider)  # type: ignore[no-untyped-call]
        expanded._of_logits = "logits" in vars(self)
        return expanded


def log_normalise(logits: Tensor) -> Tensor:
    """Log p = x − log Σ eˣ along the last dimension, for logits x, nats."""
    if _softmax_is_faster(logits):
        return logits.log_softmax(-1)
    return logits - logits.logsumexp(-1, keepdim=True)


def normalise(logits: Tensor) -> Tensor:
    """Probabilities eˣ / Σ eˣ along the last dimension, for logits x."""
    return logits.softmax(-1) if _softmax_is_faster(logits) else log_normalise(logits).exp()


def _softmax_is_faster(logits: Tensor) -> bool:
    """Whether it is, being one operation, and one for its gradient.

    Not on a CPU for thousands of rows of some ten outcomes, as under `torch.func.vmap`: there it
    takes three times as long as the operations that it stands for.
    """
    many = logits.numel() > FEW or is_functorch_wrapped_tensor(logits)
    return not many or logits.device.type != "cpu"


def probabilities(distribution: Distribution) -> Tensor:
    """Probability of every outcome.

    Args:
        distribution: One with enumerable support and batch shape (*batch,).

    Returns:
        (*batch, outcomes), in the order of the support.
    """
    if isinstance(distribution, distributions.Categorical):
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
    if isinstance(distribution, distributions.Categorical):
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
    if isinstance(distribution, distributions.Categorical):
        return index
    return distribution.enumerate_support(expand=False).flatten()[index]


def mixture(weights: Tensor, components: Distribution) -> Distribution:
    """The marginal p(y) = Σ_k w_k p(y|k).

    Args:
        weights: (*batch, K), summing to one.
        components: Distribution of batch shape (*batch, K).

    Returns:
        Batch shape (*batch,): a `Categorical` if the components can be enumerated, a
        `MixtureSameFamily` otherwise.
    """
    if components.has_enumerate_support:
        return Categorical((weights.unsqueeze(-2) @ probabilities(components)).squeeze(-2))
    return MixtureSameFamily(Categorical(weights), components, validate_args=False)
