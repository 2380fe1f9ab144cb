"""A small convolutional network as a channel."""

import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

from gymnasium.spaces import Box, Space, Tuple
from torch import nn
from torch.distributions import Distribution

from bra.channels.base import Channel
from bra.channels.readout import Readout, Start
from bra.channels.spaces import Condition, box_values, distribution, parts_of, signal_space
from bra.checks.settings import check_sizes


class CNN(Channel):
    """p(outcome | image) from 3 × 3 convolutions of stride 2 and one linear layer.

    Of a percept and an image, the percept enters the linear layer (see `Readout`).

    Args:
        condition_space: `Box` of shape (channels, height, width), or a `Tuple` with it as its last
            part; 8-bit images are scaled to [0, 1]. Any height and width, down to 1 × 1.
        outcome_space: `Discrete` (categorical) or `Box` (normal).
        channels: Feature maps of the convolutions, each of which halves height and width.
        output_gain: Gain of the Glorot initialisation of the linear layer. More than 1 lets
            outcomes start distinct.
        start: None, or "covering", where the percepts of a `Tuple` begin by sharing out the
            outcomes at random.
        covering_logit: By how much a covering start favours an outcome over all others.

    Raises:
        ValueError: If the condition space is no image, a number of feature maps is less than 1,
            `output_gain` is not positive and finite, or there is nothing that a covering start
            could share out.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Box, Tuple)

    def __init__(
        self,
        condition_space: Space[Any],
        outcome_space: Space[Any],
        channels: Sequence[int] = (16, 32),
        output_gain: float = 1.0,
        start: Start = None,
        covering_logit: float = 5.0,
    ) -> None:
        super().__init__(condition_space, outcome_space)
        self.image_space = signal_space(condition_space)
        shape = self.image_space.shape or ()
        if len(shape) != 3:
            raise ValueError(
                f"CNN cannot go from {condition_space} to {outcome_space}: its condition space "
                "must be a Box of shape (channels, height, width); use MLP for other shapes"
            )
        channels = check_sizes(channels, "channels")
        if not channels:
            raise ValueError("channels must hold at least one number, got none")
        depth, height, width = shape
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise((depth, *channels)):
            layers += [nn.Conv2d(inputs, outputs, kernel_size=3, stride=2, padding=1), nn.ReLU()]
            height, width = (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers)
        spaces = (condition_space, outcome_space)
        inputs = channels[-1] * height * width
        self.readout = Readout(inputs, *spaces, True, output_gain, start, covering_logit)

    def forward(self, condition: Condition) -> Distribution:
        """Returns p(outcome | condition), batch shape of `condition`."""
        *beside, image = parts_of(condition)
        images = box_values(self.image_space, image, self.readout.weight.dtype)
        maps = self.convolutions(images.reshape(-1, *images.shape[-3:]))
        values = maps.reshape(*images.shape[:-3], -1)
        return distribution(self.outcome_space, self.readout(values, *beside))
