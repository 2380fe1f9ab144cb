"""What an agent is made of where nobody says: chosen from what its task lets it know."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Self

import torch
from gymnasium.spaces import Box, Discrete, Space
from torch.optim import Adam

from bra.agent.optimizers import OptimizerFactory
from bra.channels import MLP, Channel, Multinomial
from bra.channels.spaces import features
from bra.checkpoints.recipes import Rebuildable, unwrap_factory
from bra.checks.settings import check_kind
from bra.cooling import Cooling
from bra.critics import Exploration, NetworkCritic
from bra.tasks import FiniteStateTask, FiniteTask, Task, knows_signals
from bra.tasks.signals import over_signals
from bra.update_rules import Projection, Rivals, ScoreFunction, UpdateRule

ChannelFactory = Callable[[Space[Any], Space[Any]], Channel]

MOST_PERCEPTS = 64
"""|X| that is chosen at most."""
SMALL = 8
"""Σ|ξᵢ| up to which perception learns fast: a step of Adam moves a unit by the rate times that."""


@dataclass(frozen=True)
class Parts:
    """What there is to choose of an agent; None leaves it open."""

    percepts: int | Discrete | Box | None = None
    update_rule: UpdateRule | None = None
    perception: ChannelFactory | None = None
    action: ChannelFactory | None = None
    perception_optimizer: OptimizerFactory | None = None
    action_optimizer: OptimizerFactory | None = None
    cooling: Cooling | None = None

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Self:
        """What of an agent's arguments is a part."""
        names = {field.name for field in fields(cls)}
        return cls(**{name: value for name, value in arguments.items() if name in names})

    @property
    def open_names(self) -> list[str]:
        """Of the parts that are to be chosen."""
        return [name for name, part in vars(self).items() if part is None]


@dataclass(frozen=True)
class Chosen:
    """All parts of an agent; see `Agent`."""

    percepts: int | Discrete | Box
    update_rule: UpdateRule
    perception: ChannelFactory
    action: ChannelFactory
    perception_optimizer: OptimizerFactory
    action_optimizer: OptimizerFactory
    cooling: Cooling | None


def choose(task: Task, given: Parts, looks: bool = False) -> Chosen:
    """The parts that are given, and for the others what serves such a task.

    |X| is the number of states where they are known, beyond which more percepts never help, else
    that of actions. A rule that is given comes without cooling, and with uniform rather than
    covering starts. Lengths that are chosen are shares of the run. Without a rule,

    * a table of utilities, and known signals or a noise that is known: `Projection` with `Rivals`;
    * a table of utilities and other noisy signals: `Projection` and cooling;
    * utilities of taken actions only: `Projection` with a critic, exploration and cooling;
    * continuous percepts or actions: `ScoreFunction`, several samples, and cooling.

    Raises:
        TypeError: If task, rule or cooling are none.
    """
    check_kind(task, Task, "task")
    for name, kind in (("update_rule", UpdateRule), ("cooling", Cooling)):
        if name not in given.open_names:
            check_kind(getattr(given, name), kind, name)
    percepts = _percepts(task) if given.percepts is None else given.percepts
    continuous = isinstance(percepts, Box) or isinstance(task.action_space, Box)
    if given.update_rule is not None:
        found = _beside_a_rule(continuous)
    elif continuous:
        found = replace(
            _beside_a_rule(continuous),
            update_rule=ScoreFunction(samples=8, baseline="leave-one-out"),
            cooling=Cooling(factor=4.0, updates=0.4),
        )
    else:
        found = _recipe(task, looks)
    if looks and not isinstance(task.observation_space, Discrete):
        found = replace(found, action=partial(MLP, hidden=[64], start="covering"))
    parts = vars(replace(found, percepts=percepts))
    return Chosen(**vars(given) | {name: parts[name] for name in given.open_names})


def _recipe(task: Task, looks: bool) -> Parts:
    """Of a task whose percepts and actions can be enumerated."""
    if not isinstance(task, FiniteTask):
        exploration = Exploration(share=0.3, updates=0.4, uniform_updates=0.1)
        rule = Projection(critic=NetworkCritic(memory=8192), exploration=exploration)
        return _projection(rule, 0.01, 0.01, Cooling(factor=16.0, updates=0.3))
    seen = over_signals(task)
    if knows_signals(seen):
        signals = features(seen.observation_space, seen.states().observation, torch.float)
        rate = 0.05 if signals.abs().sum(1).max() <= SMALL else 0.01
        rates = (rate, 0.3)
        if looks and not isinstance(task.observation_space, Discrete):
            rates = (0.01, 0.01)  # two networks, neither of which should run ahead
        return _projection(Projection(rivals=Rivals()), *rates, None)
    return _projection(Projection(), 0.01, 0.05, Cooling(factor=16.0, updates=0.4))


def chosen_line(given: Parts, found: Chosen) -> str:
    """One line that says what was chosen; empty if nothing was."""
    chosen = [(name, getattr(found, name)) for name in given.open_names]
    parts = [f"{name} {_short(part)}" for name, part in chosen if part is not None]
    return f"chosen for this task: {', '.join(parts)}" if parts else ""


def _short(part: Any) -> str:
    """A part without what it has by default."""
    if isinstance(part, Rebuildable):
        cls, arguments = type(part), part.given_arguments()
    elif isinstance(part, type | partial):
        cls, arguments = unwrap_factory(part)
    else:
        return str(part)
    inner = ", ".join(f"{name}={_short(value)}" for name, value in arguments.items())
    return f"{cls.__name__}({inner})" if inner else cls.__name__


def _percepts(task: Task) -> int:
    if isinstance(task, FiniteStateTask):
        return min(len(task.prior), MOST_PERCEPTS)
    space = task.action_space
    return min(int(space.n), MOST_PERCEPTS) if isinstance(space, Discrete) else 8


def _beside_a_rule(continuous: bool) -> Parts:
    return Parts(
        perception=MLP,
        action=MLP if continuous else Multinomial,
        perception_optimizer=partial(Adam, lr=0.003),
        action_optimizer=partial(Adam, lr=0.03),
        cooling=None,
    )


def _projection(
    rule: Projection, perception_rate: float, action_rate: float, cooling: Cooling | None
) -> Parts:
    return Parts(
        update_rule=rule,
        perception=partial(MLP, hidden=[64]),
        action=partial(Multinomial, start="covering"),
        perception_optimizer=partial(Adam, lr=perception_rate),
        action_optimizer=partial(Adam, lr=action_rate),
        cooling=cooling,
    )
