"""The last layer of a network, which the percept of a pair enters beside features of the signal."""

from typing import Any, Literal

import torch
from gymnasium.spaces import Discrete, Space, Tuple
from torch import Tensor, nn

from bra.channels.covering import check_logit, covering_logits
from bra.channels.spaces import feature_count, features, parameter_count
from bra.checks.settings import check_real

Start = Literal["covering"] | None


class Readout(nn.Linear):
    """Parameters of the outcome from features of the signal and, one-hot, the percept beside them.

    So logits are a sum of what the percept and what the signal say, as they are at the optima of
    `bra.blahut_arimoto.general`: log p(a|x,ω) is a sum of β₃U(ω,a), of what depends on x and a, and
    of a normalisation.

    Args:
        inputs: Features of the signal.
        condition_space: Of the channel; of a `Tuple` all parts but the last enter beside them.
        outcome_space: Of the channel.
        bias: Whether there are bias terms (they start at zero).
        gain: Of the Glorot initialisation.
        start: "covering", where percepts begin by sharing out the outcomes at random (see
            `bra.channels.covering`), or None.
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If `gain` is not positive and finite, `start` is unknown, or there is nothing
            that a covering start could share out.
    """

    def __init__(
        self,
        inputs: int,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        bias: bool = True,
        gain: float = 1.0,
        start: Start = None,
        covering_logit: float = 5.0,
    ) -> None:
        beside = condition_space.spaces[:-1] if isinstance(condition_space, Tuple) else ()
        width = sum(map(feature_count, beside))
        super().__init__(inputs + width, parameter_count(outcome_space), bias)
        self.beside = beside
        nn.init.xavier_uniform_(self.weight)
        if bias:
            nn.init.zeros_(self.bias)
        scale_layer(self, gain, "output_gain")
        check_logit(covering_logit)
        if start not in (None, "covering"):
            raise ValueError(f"start must be covering or None, got {start!r}")
        if start:
            logits = self._cover(condition_space, outcome_space, covering_logit)
            with torch.no_grad():
                self.weight[:, inputs : inputs + len(logits)] += logits.T

    def _cover(self, condition: Space[Any], outcome: Space[Any], logit: float) -> Tensor:
        if not isinstance(outcome, Discrete):
            raise ValueError(
                f"a covering start shares out Discrete outcomes, got {outcome}; leave start out"
            )
        if not (self.beside and isinstance(self.beside[0], Discrete)):
            raise ValueError(
                "a covering start of a network needs a Tuple of Discrete percepts and signals, got "
                f"{condition}; leave start out"
            )
        return covering_logits(int(self.beside[0].n), int(outcome.n), logit)

    def forward(self, values: Tensor, *beside: Tensor) -> Tensor:
        """Parameters, (*batch, P), from features of the signal, (*batch, F), and percepts."""
        given = zip(self.beside, beside, strict=True) if beside else ()
        joined = [features(space, part, values.dtype) for space, part in given]
        return super().forward(torch.cat([values, *joined], -1) if joined else values)


def scale_layer(layer: nn.Module, gain: float, name: str) -> None:
    """Multiplies a layer's initial weights.

    Raises:
        ValueError: If `gain` is not positive and finite.
    """
    check_real(gain, name, "positive and finite", lambda gain: gain > 0)
    with torch.no_grad():
        layer.get_parameter("weight").mul_(gain)
