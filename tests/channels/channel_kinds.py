"""Channels of all kinds, between spaces of all kinds."""

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, Tuple
from torch import nn
from torch.distributions import Categorical

from bra.channels import CNN, MLP, Channel, Gaussian, Multinomial, Table


class Noisy(Channel):
    """The example in Channel's docstring."""

    def __init__(self, condition_space, outcome_space, width=32):
        super().__init__(condition_space, outcome_space)
        self.net = nn.Sequential(
            nn.LazyLinear(width), nn.ReLU(), nn.Linear(width, int(outcome_space.n))
        )

    def forward(self, condition):
        return Categorical(logits=self.net(condition))


class Gated(Channel):
    """A channel of one's own with two conditions: a specialist for each percept."""

    condition_spaces = (Tuple,)

    def __init__(self, condition_space, outcome_space):
        super().__init__(condition_space, outcome_space)
        percepts, signals = condition_space
        self.weight = nn.Parameter(
            torch.randn(int(percepts.n), signals.shape[0], int(outcome_space.n))
        )

    def forward(self, condition):
        percept, signal = condition
        return Categorical(logits=(signal.unsqueeze(-2) @ self.weight[percept]).squeeze(-2))


def real(*shape):
    return Box(-np.inf, np.inf, shape=shape, dtype=np.float32)


def image(*shape):
    return Box(0, 255, shape=shape, dtype=np.uint8)


def pair(percepts, observation):
    return Tuple((Discrete(percepts), observation))


# name: class, own arguments, condition space, outcome space
INSTANCES = {
    "mlp index to index": (MLP, {}, Discrete(3), Discrete(4)),
    "mlp of the paper": (MLP, {"hidden": [20], "bias": False}, real(4), Discrete(13)),
    "mlp deep, relu": (MLP, {"hidden": [8, 8], "activation": nn.ReLU}, real(2, 3), Discrete(3)),
    "mlp linear": (MLP, {"hidden": []}, real(3), Discrete(2)),
    "mlp linear table": (MLP, {"hidden": [], "bias": False}, Discrete(4), Discrete(5)),
    "mlp scalar to index": (MLP, {"activation": nn.SiLU}, real(), Discrete(3)),
    "mlp 8-bit": (MLP, {"activation": nn.Sigmoid}, image(1, 2, 2), Discrete(3)),
    "mlp index to number": (MLP, {"hidden": [6]}, Discrete(4), real(1)),
    "mlp index to scalar": (MLP, {"hidden": []}, Discrete(4), real()),
    "mlp box to box": (MLP, {"activation": nn.GELU, "bias": False}, real(3), real(2)),
    "mlp box to matrix": (MLP, {"hidden": [5, 4]}, real(2, 2), real(2, 3)),
    "cnn": (CNN, {}, real(1, 3, 3), Discrete(3)),
    "cnn 8-bit, oblong": (CNN, {"channels": [4]}, image(3, 6, 5), Discrete(2)),
    "cnn 1 × 1": (CNN, {"channels": [4, 4, 4]}, real(2, 1, 1), Discrete(4)),
    "cnn to box": (CNN, {"channels": [4, 8]}, real(1, 4, 4), real(2)),
    "table": (Table, {}, Discrete(5), Discrete(3)),
    "table, one outcome": (Table, {"spread": 0.0}, Discrete(2), Discrete(1)),
    "multinomial": (Multinomial, {}, Discrete(4), Discrete(5)),
    "multinomial, reference in the middle": (
        Multinomial,
        {"reference": 1, "start": [[1.0, -2.0], [0.5, 3.0]]},
        Discrete(2),
        Discrete(3),
    ),
    "multinomial, covering": (Multinomial, {"start": "covering"}, Discrete(4), Discrete(3)),
    "table, covering": (Table, {"start": "covering"}, Discrete(3), Discrete(4)),
    "multinomial, reference last": (Multinomial, {"reference": 2}, Discrete(4), Discrete(3)),
    "gaussian": (Gaussian, {}, Discrete(4), real(1)),
    "gaussian, narrow": (Gaussian, {"scale": 0.05}, Discrete(3), real(2, 3)),
    "gaussian, scalar": (Gaussian, {"scale": 2.0}, Discrete(3), real()),
    "custom": (Noisy, {"width": 7}, real(4), Discrete(3)),
    "table of pairs": (Table, {"start": "covering"}, pair(3, Discrete(4)), Discrete(5)),
    "multinomial of pairs": (Multinomial, {"reference": 1}, pair(3, Discrete(2)), Discrete(4)),
    "gaussian of pairs": (Gaussian, {}, pair(2, Discrete(3)), real(1)),
    "mlp of pairs": (MLP, {"hidden": [5]}, pair(3, real(2, 2)), Discrete(4)),
    "mlp of pairs to box": (MLP, {"hidden": [5]}, pair(3, Discrete(2)), real(1)),
    "mlp of pairs, covering": (MLP, {"start": "covering"}, pair(3, real(2)), Discrete(4)),
    "cnn of pairs": (CNN, {"channels": [4]}, pair(3, image(1, 3, 4)), Discrete(4)),
    "cnn of pairs to box": (CNN, {"channels": [2]}, pair(2, real(1, 3, 3)), real(2)),
    "custom, of pairs": (Gated, {}, pair(3, real(4)), Discrete(3)),
}


def make(name, seed=0):
    cls, arguments, condition_space, outcome_space = INSTANCES[name]
    torch.manual_seed(seed)
    return cls(condition_space, outcome_space, **arguments)
