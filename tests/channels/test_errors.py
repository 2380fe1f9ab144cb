"""What channels refuse, and how they say it."""

import math
import re

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete, MultiBinary
from torch import nn
from torch.distributions import Bernoulli, Categorical, Normal, Poisson

from bra.channels import CNN, MLP, Channel, Gaussian, Multinomial, Table
from bra.channels.base import check_channel

NUMBERS = Box(-1, 1, shape=(2,), dtype=np.float32)
IMAGE = Box(0, 1, shape=(1, 3, 3), dtype=np.float32)


@pytest.mark.parametrize(
    ("cls", "condition_space", "outcome_space", "reason"),
    [
        (Table, NUMBERS, Discrete(2), "its condition space must be Discrete"),
        (Table, Discrete(2), NUMBERS, "its outcome space must be Discrete"),
        (Multinomial, NUMBERS, Discrete(2), "its condition space must be Discrete"),
        (Multinomial, Discrete(2), NUMBERS, "its outcome space must be Discrete"),
        (Gaussian, NUMBERS, NUMBERS, "its condition space must be Discrete"),
        (Gaussian, Discrete(3), Discrete(2), "its outcome space must be Box"),
        (CNN, Discrete(3), Discrete(2), "its condition space must be Box"),
        (CNN, NUMBERS, Discrete(2), "must be a Box of shape (channels, height, width); use MLP"),
        (MLP, MultiBinary(3), Discrete(2), "its condition space must be Discrete or Box"),
        (MLP, Discrete(2), MultiBinary(3), "its outcome space must be Discrete or Box"),
        (CNN, IMAGE, MultiBinary(3), "its outcome space must be Discrete or Box"),
    ],
)
def test_refused_spaces_are_named(cls, condition_space, outcome_space, reason):
    with pytest.raises(ValueError, match=re.escape(reason)) as raised:
        cls(condition_space, outcome_space)
    assert f"{cls.__name__} cannot go from {condition_space} to {outcome_space}" in str(
        raised.value
    )


@pytest.mark.parametrize("cls", [MLP, Table, Multinomial])
def test_discrete_spaces_start_at_zero(cls):
    with pytest.raises(ValueError, match=r"condition space Discrete\(3, start=1\) must start at 0"):
        cls(Discrete(3, start=1), Discrete(2))
    with pytest.raises(ValueError, match=r"outcome space Discrete\(2, start=-1\) must start at 0"):
        cls(Discrete(3), Discrete(2, start=-1))


@pytest.mark.parametrize(
    ("cls", "spaces", "arguments", "message"),
    [
        (MLP, (NUMBERS, Discrete(2)), {"hidden": [4, 0]}, r"at least 1, got \[4, 0\]"),
        (MLP, (NUMBERS, Discrete(2)), {"hidden": [-3]}, r"at least 1, got \[-3\]"),
        (CNN, (IMAGE, Discrete(2)), {"channels": []}, "channels must hold at least one number"),
        (CNN, (IMAGE, Discrete(2)), {"channels": [0]}, r"channels must be at least 1, got \[0\]"),
        (Multinomial, (Discrete(2), Discrete(3)), {"reference": 3}, "0 to 2, got 3"),
        (Multinomial, (Discrete(2), Discrete(3)), {"reference": -1}, "0 to 2, got -1"),
        (
            Multinomial,
            (Discrete(2), Discrete(3)),
            {"start": torch.zeros(3, 2)},
            r"of shape \(2, 2\) .*got shape \(3, 2\)",
        ),
        (
            Multinomial,
            (Discrete(2), Discrete(2)),
            {"start": [[math.nan, 0.0]]},
            "or finite and of shape",
        ),
        (
            Multinomial,
            (Discrete(2), Discrete(2)),
            {"start": "cover"},
            "start must be covering, or finite .*got 'cover'",
        ),
        (
            Multinomial,
            (Discrete(2), Discrete(2)),
            {"start": "covering", "covering_logit": -1.0},
            "covering_logit must be finite and at least 0, got -1.0",
        ),
        (
            Multinomial,
            (Discrete(2), NUMBERS),
            {"start": "covering"},
            "Multinomial cannot go .*its outcome space must be Discrete",
        ),
        (Table, (Discrete(2), Discrete(2)), {"start": "all"}, "covering or None, got 'all'"),
        (MLP, (NUMBERS, Discrete(2)), {"input_gain": 0.0}, "input_gain must be positive.*got 0.0"),
        (MLP, (NUMBERS, Discrete(2)), {"output_gain": math.inf}, "output_gain must be .*got inf"),
        (CNN, (IMAGE, Discrete(2)), {"output_gain": -1.0}, "output_gain must be .*got -1.0"),
        (Gaussian, (Discrete(2), NUMBERS), {"scale": 0.0}, "more than 0.001, got 0.0"),
        (Gaussian, (Discrete(2), NUMBERS), {"scale": 1e-3}, "more than 0.001, got 0.001"),
        (Gaussian, (Discrete(2), NUMBERS), {"scale": math.inf}, "finite .*got inf"),
        (Gaussian, (Discrete(2), NUMBERS), {"scale": math.nan}, "finite .*got nan"),
        (Table, (Discrete(2), Discrete(2)), {"spread": -1.0}, "at least 0, got -1.0"),
        (Table, (Discrete(2), Discrete(2)), {"spread": math.inf}, "finite .*got inf"),
        (Table, (Discrete(2), Discrete(2)), {"spread": math.nan}, "finite .*got nan"),
    ],
)
def test_bad_arguments_are_refused(cls, spaces, arguments, message):
    with pytest.raises(ValueError, match=message):
        cls(*spaces, **arguments)


@pytest.mark.parametrize("channel", [MLP(IMAGE, Discrete(2)), CNN(IMAGE, Discrete(2))])
def test_conditions_of_another_shape_are_refused(channel):
    message = r"shape \(5, 1, 4, 3\) does not end in \(1, 3, 3\)"
    with pytest.raises(ValueError, match=message):
        channel(torch.zeros(5, 1, 4, 3))


def channel_returning(function, outcome_space):
    class Returning(Channel):
        def forward(self, condition):
            return function(condition)

    return Returning(NUMBERS, outcome_space)


@pytest.mark.parametrize(
    ("function", "outcome_space", "error", "message"),
    [
        (lambda c: c.sum(-1), Discrete(2), TypeError, "forward returned Tensor; expected a torch"),
        (
            lambda c: Categorical(torch.ones(3)),
            Discrete(3),
            ValueError,
            r"batch shape \(\) for conditions of batch shape \(2,\)",
        ),
        (
            lambda c: Normal(c, 1.0),
            NUMBERS,
            ValueError,
            r"batch shape \(2, 2\) .*torch.distributions.Independent",
        ),
        (
            lambda c: Normal(c[..., 0], 1.0),
            NUMBERS,
            ValueError,
            r"event shape \(\); its outcome space Box.* asks for \(2,\)",
        ),
        (
            lambda c: torch.distributions.Independent(Normal(c, 1.0), 1),
            Discrete(2),
            ValueError,
            r"event shape \(2,\); its outcome space Discrete\(2\) asks for \(\)",
        ),
        (
            lambda c: Categorical(torch.ones(*c.shape[:-1], 3)),
            Discrete(4),
            ValueError,
            r"over 3 outcomes; its outcome space Discrete\(4\) has 4",
        ),
    ],
)
def test_check_channel_refuses(function, outcome_space, error, message):
    with pytest.raises(error, match=message) as raised:
        check_channel(channel_returning(function, outcome_space))
    assert str(raised.value).startswith("Returning.forward")


@pytest.mark.parametrize(
    "function",
    [lambda c: Bernoulli(torch.full((2,), 0.5)), lambda c: Poisson(torch.ones(2))],
    ids=["floats", "no end"],
)
def test_check_channel_refuses_outcomes_that_are_no_indices(function):
    # Floats cannot index a Table or Multinomial, and counts have no end.
    with pytest.raises((TypeError, ValueError), match=r"Returning.forward .*Discrete\(2\)"):
        check_channel(channel_returning(function, Discrete(2)))


def test_check_channel_refuses_other_modules():
    with pytest.raises(TypeError, match=r"Linear is no bra.channels.Channel"):
        check_channel(nn.Linear(2, 2))


@pytest.mark.parametrize("training", [True, False])
def test_check_channel_leaves_the_mode_alone(training):
    channel = MLP(NUMBERS, Discrete(2)).train(training)
    check_channel(channel)
    assert channel.training is training
    assert channel.network.training is training
