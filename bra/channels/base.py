"""The common interface of all channels: a space in, a distribution over a space out."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from torch import Tensor, nn
from torch.distributions import Distribution

from bra.channels.distributions import probabilities
from bra.channels.spaces import Condition, feature_count
from bra.checks.words import amount


class Channel(nn.Module, ABC):
    """A conditional distribution p(outcome | condition) between two `gymnasium.spaces`.

    A channel of one's own is a subclass with a `forward`; scoring and sampling belong to the
    distribution that it returns:

        class Noisy(Channel):
            def __init__(self, condition_space, outcome_space, width=32):
                super().__init__(condition_space, outcome_space)
                self.net = nn.Sequential(nn.LazyLinear(width), nn.ReLU(),
                                         nn.Linear(width, int(outcome_space.n)))

            def forward(self, condition):
                return Categorical(logits=self.net(condition))

    Conditions arrive as tensors of shape (*batch,) for a `Discrete` space (indices) and
    (*batch, *space.shape) for a `Box`; `batch` may have any number of dimensions. An
    action that looks at the signal again has as its condition space the `Tuple` of percepts and
    observations, and is given a tuple of two such tensors; a class that takes it says so in
    `condition_spaces`. Avoid data-dependent control flow in `forward` (and pass
    `validate_args=False` to distributions), so that the channel runs under `torch.func.vmap` and
    `torch.compile`.

    Args:
        condition_space: What the channel is given: the task's observations or the percepts.
        outcome_space: What the channel decides on: the percepts or the task's actions.

    Attributes:
        condition_spaces: Types of condition space that the class takes.
        outcome_spaces: Types of outcome space that the class takes.

    Raises:
        ValueError: If the class does not take one of the spaces.
    """

    condition_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Box)
    outcome_spaces: ClassVar[tuple[type[Space[Any]], ...]] = (Discrete, Box)

    def __init__(self, condition_space: Space[Any], outcome_space: Space[Any]) -> None:
        super().__init__()
        for role, space, accepted in (
            ("condition", condition_space, self.condition_spaces),
            ("outcome", outcome_space, self.outcome_spaces),
        ):
            if not isinstance(space, accepted):
                names = " or ".join(kind.__name__ for kind in accepted)
                raise ValueError(
                    f"{type(self).__name__} cannot go from {condition_space} to {outcome_space}: "
                    f"its {role} space must be {names}"
                )
            if isinstance(space, Discrete) and space.start != 0:
                raise ValueError(f"{role} space {space} must start at 0; subtract its start")
        self.condition_space = condition_space
        self.outcome_space = outcome_space

    def extra_repr(self) -> str:
        """The spaces, for `repr`."""
        return f"{self.condition_space} → {self.outcome_space}"

    @abstractmethod
    def forward(self, condition: Tensor) -> Distribution:
        """Returns p(outcome | condition) with the batch shape of `condition`."""

    def forward_all(self) -> Distribution:
        """p(outcome | c) for every condition c = 0 … n − 1 of a `Discrete(n)`, batch shape (n,).

        Channels that keep a row per condition may override it, to save looking the rows up.
        """
        example = next(self.parameters(), None)
        device = None if example is None else example.device
        conditions = torch.arange(feature_count(self.condition_space), device=device)
        every: Distribution = self(conditions)
        return every


def check_channel(channel: nn.Module) -> None:
    """Runs a channel once and checks that it honours the contract of `Channel`.

    Args:
        channel: A module with `condition_space` and `outcome_space`.

    Raises:
        TypeError: If `forward` returns no `torch.distributions.Distribution`.
        ValueError: If the distribution has another batch or event shape than the spaces ask for.
    """
    name = type(channel).__name__
    if not isinstance(channel, Channel):
        raise TypeError(f"{name} is no bra.channels.Channel; derive it from Channel")
    condition = example_conditions(channel.condition_space)
    was_training = channel.training
    with torch.no_grad():
        distribution = channel.eval()(condition)
    channel.train(was_training)

    if not isinstance(distribution, Distribution):
        raise TypeError(
            f"{name}.forward returned {type(distribution).__name__}; "
            "expected a torch.distributions.Distribution"
        )
    if distribution.batch_shape != (2,):
        raise ValueError(
            f"{name}.forward returned a distribution of batch shape "
            f"{tuple(distribution.batch_shape)} for conditions of batch shape (2,); "
            "wrap trailing dimensions in torch.distributions.Independent"
        )
    space = channel.outcome_space
    event_shape = () if isinstance(space, Discrete) else space.shape
    if distribution.event_shape != event_shape:
        raise ValueError(
            f"{name}.forward returned a distribution of event shape "
            f"{tuple(distribution.event_shape)}; its outcome space {space} asks for {event_shape}"
        )
    if isinstance(space, Discrete):
        if not distribution.has_enumerate_support or distribution.sample().is_floating_point():
            raise ValueError(
                f"{name}.forward returned {type(distribution).__name__}; its outcome space {space} "
                "asks for a distribution over whole numbers that can be enumerated, such as "
                "Categorical"
            )
        count = probabilities(distribution).shape[-1]
        if count != space.n:
            raise ValueError(
                f"{name}.forward returned a distribution over {amount(count, 'outcome')}; "
                f"its outcome space {space} has {space.n}"
            )


def example_conditions(space: Space[Any]) -> Condition:
    """Two conditions of a space, as a channel receives them."""
    if isinstance(space, Tuple):
        return tuple(_examples(part) for part in space)
    return _examples(space)


def _examples(space: Space[Any]) -> Tensor:
    if isinstance(space, Discrete):
        return torch.zeros(2, dtype=torch.long)
    return torch.zeros(2, *(space.shape or ()))
