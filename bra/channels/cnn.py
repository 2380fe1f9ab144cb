"""A small convolutional network as a channel."""

import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

from gymnasium.spaces import Box, Space
from torch import Tensor, nn
from torch.distributions import Distribution

from bra.channels.base import Channel
from bra.channels.mlp import scale_layer, xavier_linear
from bra.channels.spaces import box_values, distribution, parameter_count


class CNN(Channel):
    """p(outcome | image) from 3 × 3 convolutions of stride 2 and one linear layer.

    Args:
        condition_space: `Box` of shape (channels, height, width); 8-bit images are scaled to
            [0, 1]. Any height and width, down to 1 × 1.
        outcome_space: `Discrete` (categorical) or `Box` (normal).
        channels: Feature maps of the convolutions, each of which halves height and width.
        output_gain: Gain of the Glorot initialisation of the linear layer. More than 1 lets
            outcomes start distinct.

    Raises:
        ValueError: If the condition space is no image, or a number of feature maps is less
            than 1, or `output_gain` is not positive and finite.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Box,)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        channels: Sequence[int] = (16, 32),
        output_gain: float = 1.0,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        shape = condition_space.shape or ()
        if len(shape) != 3:
            raise ValueError(
                f"CNN cannot go from {condition_space} to {outcome_space}: its condition space "
                "must be a Box of shape (channels, height, width); use MLP for other shapes"
            )
        if not channels or any(count < 1 for count in channels):
            raise ValueError(f"channels must be at least one number, each ≥ 1, got {channels}")
        depth, height, width = shape
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise((depth, *channels)):
            layers += [nn.Conv2d(inputs, outputs, kernel_size=3, stride=2, padding=1), nn.ReLU()]
            height, width = (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        self.readout = xavier_linear(
            channels[-1] * height * width, parameter_count(outcome_space), bias=True
        )
        scale_layer(self.readout, output_gain, "output_gain")

    def forward(self, condition: Tensor) -> Distribution:
        """Returns p(outcome | image), batch shape of `condition`."""
        images = box_values(self.condition_space, condition, self.readout.weight.dtype)
        batch = images.shape[:-3]
        maps = self.convolutions(images.reshape(-1, *images.shape[-3:]))
        parameters = self.readout(maps.flatten(1)).reshape((*batch, self.readout.out_features))
        return distribution(self.outcome_space, parameters)
