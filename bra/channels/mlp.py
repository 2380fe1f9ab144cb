"""A multi-layer perceptron as a channel."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from torch import nn
from torch.distributions import Distribution

from bra.channels.base import Channel
from bra.channels.spaces import (
    Condition,
    distribution,
    feature_count,
    features,
    parameter_count,
)


class MLP(Channel):
    """p(outcome | condition) from a fully connected network.

    With one hidden layer, tanh and no bias it is the perception channel of Peng, Genewein,
    Leibfried & Braun (IROS 2017), p(x = xᵢ|ξ) = softmax(tanh(ξᵀV) W)ᵢ:
    `MLP(observations, percepts, hidden=[20], bias=False)`.

    `Discrete` conditions enter one-hot, `Box` conditions flattened, both parts of a `Tuple` side by
    side. `Discrete` outcomes are
    categorical; `Box` outcomes are normals with mean and log-scale from the network.

    Args:
        condition_space: `Discrete`, `Box`, or a `Tuple` of such.
        outcome_space: `Discrete` or `Box`.
        hidden: Sizes of the hidden layers; none gives a linear (softmax) channel.
        activation: Makes the non-linearity after each hidden layer.
        bias: Whether layers have bias terms (they start at zero).
        input_gain: Gain of the first layer's Glorot initialisation. More than 1 lets hidden units
            start saturated, each on a corner of the signals, rather than linear.
        output_gain: Gain of the last layer's. More than 1 lets outcomes start distinct.

    Raises:
        ValueError: If a hidden size is less than 1, or a gain is not positive and finite.
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
    ) -> None:
        super().__init__(condition_space, outcome_space)
        if any(size < 1 for size in hidden):
            raise ValueError(f"hidden sizes must be at least 1, got {list(hidden)}")
        sizes = [feature_count(condition_space), *hidden, parameter_count(outcome_space)]
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(sizes):
            layers += [xavier_linear(inputs, outputs, bias), activation()]
        self.network = nn.Sequential(*layers[:-1])
        scale_layer(layers[0], input_gain, "input_gain")
        scale_layer(layers[-2], output_gain, "output_gain")

    def forward(self, condition: Condition) -> Distribution:
        """Returns p(outcome | condition), batch shape of `condition`."""
        inputs = features(self.condition_space, condition, next(self.parameters()).dtype)
        return distribution(self.outcome_space, self.network(inputs))


def xavier_linear(inputs: int, outputs: int, bias: bool) -> nn.Linear:
    """A linear layer with Glorot-uniform weights and zero bias (Glorot & Bengio, AISTATS 2010)."""
    layer = nn.Linear(inputs, outputs, bias=bias)
    nn.init.xavier_uniform_(layer.weight)
    if bias:
        with torch.no_grad():
            layer.bias.zero_()
    return layer


def scale_layer(layer: nn.Module, gain: float, name: str) -> None:
    """Multiplies a layer's initial weights.

    Raises:
        ValueError: If `gain` is not positive and finite.
    """
    if not 0 < gain < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {gain}")
    with torch.no_grad():
        layer.get_parameter("weight").mul_(gain)
