"""A multi-layer perceptron as a channel."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from torch import nn
from torch.distributions import Distribution

from bra.channels.base import Channel
from bra.channels.readout import Readout, Start, scale_layer
from bra.channels.spaces import (
    Condition,
    distribution,
    feature_count,
    features,
    parts_of,
    signal_space,
)
from bra.checks.settings import check_flag, check_sizes


class MLP(Channel):
    """p(outcome | condition) from a fully connected network.

    With one hidden layer, tanh and no bias it is the perception channel of Peng, Genewein,
    Leibfried & Braun (IROS 2017), p(x = xᵢ|ξ) = softmax(tanh(ξᵀV) W)ᵢ:
    `MLP(observations, percepts, hidden=[20], bias=False)`.

    `Discrete` conditions enter one-hot, `Box` conditions flattened. `Discrete` outcomes are
    categorical; `Box` outcomes are normals with mean and log-scale from the network. Of a percept
    and a signal, the signal enters the first layer, and the percept the last (see `Readout`).

    Args:
        condition_space: `Discrete`, `Box`, or a `Tuple` of such, the signal last.
        outcome_space: `Discrete` or `Box`.
        hidden: Sizes of the hidden layers; none gives a linear (softmax) channel.
        activation: Makes the non-linearity after each hidden layer.
        bias: Whether layers have bias terms (they start at zero).
        input_gain: Gain of the first layer's Glorot initialisation. More than 1 lets hidden units
            start saturated, each on a corner of the signals, rather than linear.
        output_gain: Gain of the last layer's. More than 1 lets outcomes start distinct.
        start: None, or "covering", where the percepts of a `Tuple` begin by sharing out the
            outcomes at random.
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If a hidden size is less than 1, a gain is not positive and finite, or there is
            nothing that a covering start could share out.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Box, Tuple)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        hidden: Sequence[int] = (20,),
        activation: Callable[[], nn.Module] = nn.Tanh,
        bias: bool = True,
        input_gain: float = 1.0,
        output_gain: float = 1.0,
        start: Start = None,
        covering_logit: float = 5.0,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        self.signal_space = signal_space(condition_space)
        sizes = [feature_count(self.signal_space), *check_sizes(hidden, "hidden sizes")]
        bias = check_flag(bias, "bias")
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(sizes):
            layers += [xavier_linear(inputs, outputs, bias), activation()]
        spaces = (condition_space, outcome_space)
        layers.append(Readout(sizes[-1], *spaces, bias, output_gain, start, covering_logit))
        self.network = nn.Sequential(*layers)
        scale_layer(layers[0], input_gain, "input_gain")

    def forward(self, condition: Condition) -> Distribution:
        """Returns p(outcome | condition), batch shape of `condition`."""
        *beside, signal = parts_of(condition)
        values = features(self.signal_space, signal, next(self.parameters()).dtype)
        *layers, readout = self.network
        for layer in layers:
            values = layer(values)
        return distribution(self.outcome_space, readout(values, *beside))


def xavier_linear(inputs: int, outputs: int, bias: bool) -> nn.Linear:
    """A linear layer with Glorot-uniform weights and zero bias (Glorot & Bengio, AISTATS 2010)."""
    layer = nn.Linear(inputs, outputs, bias=bias)
    nn.init.xavier_uniform_(layer.weight)
    if bias:
        with torch.no_grad():
            layer.bias.zero_()
    return layer
