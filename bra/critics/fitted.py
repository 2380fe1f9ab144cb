"""A network that is fitted beside the channels, and is no part of what their optimizers move."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import torch
from gymnasium.spaces import Space
from torch import Tensor, nn
from torch.func import functional_call, grad

from bra.channels.mlp import xavier_linear
from bra.channels.spaces import feature_count, features

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class FittedNetwork(nn.Module):
    """A fully connected network of rectified linear units, fitted by Adam (Kingma & Ba 2015).

    The moments of its gradient are buffers, so that they are part of the checkpoint, and steps run
    under `torch.func.vmap`. No gradient of others flows through it.

    Args:
        space: Where its inputs live.
        hidden: Sizes of the hidden layers.
        outputs: Number of its outputs.
        lr: Learning rate.
    """

    mean: Tensor
    square: Tensor
    made: Tensor

    def __init__(self, space: Space[Any], hidden: Sequence[int], outputs: int, lr: float) -> None:
        super().__init__()
        self.space, self.lr = space, lr
        layers: list[nn.Module] = []
        for sizes in itertools.pairwise([feature_count(space), *hidden, outputs]):
            layers += [xavier_linear(*sizes, bias=True), nn.ReLU()]
        self.layers = nn.Sequential(*layers[:-1]).requires_grad_(False)
        size = sum(weight.numel() for weight in self.layers.parameters())
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("square", torch.zeros(size))
        self.register_buffer("made", torch.zeros(()))

    def forward(self, inputs: Tensor) -> Tensor:
        """Outputs, (B, outputs), of inputs (B, …)."""
        found: Tensor = self.layers(features(self.space, inputs, torch.get_default_dtype()))
        return found

    def step(self, inputs: Tensor, loss: Callable[[Tensor], Tensor]) -> None:
        """One step of Adam down a loss of the outputs, a scalar."""
        weights = dict(self.layers.named_parameters())
        given = features(self.space, inputs, torch.get_default_dtype())
        gradient = grad(lambda own: loss(functional_call(self.layers, own, (given,))))(weights)
        flat = torch.cat([gradient[name].flatten() for name in weights])
        self.made += 1
        self.mean.mul_(BETA_1).add_(flat, alpha=1 - BETA_1)
        self.square.mul_(BETA_2).add_(flat.square(), alpha=1 - BETA_2)
        scale = (self.square / (1 - BETA_2**self.made)).sqrt() + EPSILON
        step = self.lr * self.mean / (1 - BETA_1**self.made) / scale
        sizes = [weight.numel() for weight in weights.values()]
        for weight, part in zip(weights.values(), torch.split(step, sizes), strict=True):
            weight.sub_(part.view_as(weight))
