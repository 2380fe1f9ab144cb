"""Tasks with finitely many world-states."""

from collections.abc import Iterable, Sequence
from typing import Any, TypeGuard

import torch
from gymnasium.spaces import Discrete, Space
from torch import Generator, Tensor

from bra.checks.arrays import Array, names_of
from bra.checks.settings import is_scalar
from bra.checks.tables import check_conditional, check_prior, check_utilities
from bra.randomness.draws import Streams
from bra.tasks.base import Task, World
from bra.tasks.csv_tables import check_labels
from bra.tasks.observations import Code, observation_table

FAR = 1000
"""Ranges beyond which utilities drown in the distance from 0."""
PENALTY = 30
"""What a forbidden action costs, in ranges of the utilities that are finite."""


class FiniteStateTask(Task):
    """A task with W known world-states.

    The sensor is noiseless, one signal ξ per state, unless `signal_given_state` says which of S
    signals it shows; or `observations` is a space: then ξ ~ p(ξ|ω) is drawn by the subclass's
    `observe`.

    Args:
        prior: p(ω), (W,); uniform if None.
        state_names: A name per state.
        observations: Sensor signals, see `observation_table`: one per state, or S of them.
        state_numbers: Numbers for the binary codes; 0 … W − 1 if None.
        signal_given_state: p(s|ω), (W, S), of a noisy sensor with S signals; None is noiseless.

    Attributes:
        prior: p(ω), (W,), float64.
        state_names: W names.
        observations: ξ of every state, (W,) or (W, *shape); None if the sensor is noisy.
        signal_given_state: p(s|ω), (W, S), float64; None if noiseless, or not known.

    Raises:
        ValueError: If the prior is no distribution over the states, or `signal_given_state` not one
            over signals for each of them.
    """

    def __init__(
        self,
        prior: Array | None,
        state_names: Sequence[str],
        observations: Code | Array | Space[Any] = "onehot",
        state_numbers: Sequence[int] | None = None,
        signal_given_state: Array | None = None,
    ) -> None:
        self.state_names = tuple(state_names)
        named, _ = names_of(prior)
        if named and tuple(named) != self.state_names:
            raise ValueError(
                f"prior is of states {named}, expected {list(self.state_names)}; bring it in order"
            )
        self.prior = check_prior(prior, len(self.state_names))
        cumulated = self.prior.cumsum(0)
        # Divided, so that the last is 1 whatever the rounding.
        self._thresholds = cumulated / cumulated[-1]
        self.signal_given_state = None
        signals = len(self.state_names)
        if signal_given_state is not None:
            self.signal_given_state = check_conditional(signal_given_state, signals)
            signals = self.signal_given_state.shape[1]
            if observations == Discrete(signals):
                observations = "index"
        self.observation_space, self._codes = observation_table(
            observations, signals, state_numbers
        )
        self.observations = self._codes if self.signal_given_state is None else None

    def sample(self, count: int, generator: Generator) -> World:
        """Draws states from the prior; see `Task.sample`."""
        numbers = torch.rand(count, dtype=torch.double, generator=generator)
        if self.noiseless:
            return self._worlds_at(numbers)
        state = self._states_at(numbers)
        return World(state, self.observe(state, generator))

    def sample_streams(self, count: int, streams: Streams, update: int) -> World:
        """Draws for all streams in one go, unless signals are noisy; see `Task.sample_streams`."""
        if not self.noiseless:
            return super().sample_streams(count, streams, update)
        size = max(1, self._signals()[0].numel())
        return World(*streams.ahead(update, count, self._worlds_at, size))

    def sample_updates(self, count: int, streams: Streams, updates: range) -> World:
        """Draws for all updates in one go, unless signals are noisy."""
        if not self.noiseless:
            return super().sample_updates(count, streams, updates)
        return self._worlds_at(streams.along(updates, count))

    def _worlds_at(self, numbers: Tensor) -> World:
        """The worlds of numbers in [0, 1), one each: a function of nothing else."""
        state, signals = self._states_at(numbers), self._signals()
        observation = signals.index_select(0, state.flatten())  # half the time of [state]
        return World(state, observation.reshape(*state.shape, *signals.shape[1:]))

    def _states_at(self, numbers: Tensor) -> Tensor:
        """States by the inverse of the prior's distribution function; see `distributions.draw`."""
        return torch.searchsorted(self._thresholds, numbers.contiguous(), right=True)

    def observe(self, state: Tensor, generator: Generator) -> Tensor:
        """Sensor signals ξ ~ p(ξ|ω) of states, (batch,) to (batch, …), drawn from `generator`."""
        if self.signal_given_state is None or self._codes is None:
            return self._signals()[state]
        rows = self.signal_given_state[state.flatten()]
        shown = torch.multinomial(rows, 1, generator=generator).reshape(state.shape)
        return self._codes[shown]

    @property
    def noiseless(self) -> bool:
        """Whether a state has one signal only."""
        return self.observations is not None

    def states(self) -> World:
        """All states in order with their signals, batch shape (W,).

        Raises:
            ValueError: If the sensor is noisy.
        """
        return World(torch.arange(len(self.prior)), self._signals())

    def _signals(self) -> Tensor:
        if self.observations is None:
            raise ValueError(
                f"{type(self).__name__} has a noisy sensor and no table of signals; draw them with "
                "observe(state, generator)"
            )
        return self.observations


def knows_signals(task: Task) -> TypeGuard[FiniteStateTask]:
    """Whether all signals of a task are known: finitely many states and a noiseless sensor."""
    return isinstance(task, FiniteStateTask) and task.noiseless


class FiniteTask(FiniteStateTask):
    """A task with finitely many world-states and actions: it has a certified optimum.

    An action may be forbidden in a state by a utility of −inf: the optimum never takes it there. An
    agent's probabilities fall, but not to zero, and 0 · ∞ has no gradient. So where it learns and
    is measured a forbidden action pays `PENALTY` times the range of the finite utilities less than
    the least of them, the range counting as 1 if it is 0: far more than any mistake costs, small
    enough for gradients. As its probability goes to 0, J goes to what it is with −inf. Agents to
    whom information is dearer than that, who need it to do without forbidden actions, take them.

    Args:
        utilities: U(ω, a), (W, A); −inf for a forbidden action.
        prior: p(ω), (W,); uniform if None.
        observations: Sensor signals, see `observation_table`.
        state_names: A name per state; s0, s1, … if None.
        action_names: A name per action; a0, a1, … if None.
        state_numbers: Numbers for the binary codes; 0 … W − 1 if None.
        signal_given_state: p(s|ω), (W, S), of a noisy sensor with S signals; None is noiseless.

    Attributes:
        utilities: U(ω, a), (W, A), float64.
        payoffs: What agents are paid: the utilities, with a penalty for forbidden actions, (W, A).
        origins: What sampled utilities of a state are best counted from, (W,), float64: a middle
            one, where utilities are further from 0 than `FAR` times what actions differ by, else 0.
        action_names: A names.

    Raises:
        ValueError: If utilities are no (W, A) table, hold NaN or +inf, or forbid all actions of a
            state, or if a name is missing.
    """

    action_space: Discrete

    def __init__(
        self,
        utilities: Array,
        prior: Array | None = None,
        observations: Code | Array | Space[Any] = "onehot",
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        state_numbers: Sequence[int] | None = None,
        signal_given_state: Array | None = None,
    ) -> None:
        self.utilities = check_utilities(utilities)
        self.payoffs = _payoffs(self.utilities)
        far = self.payoffs.abs().amax() > FAR * self.stakes
        self.origins = torch.where(far, self.payoffs.median(-1).values, 0.0)
        states, actions = self.utilities.shape
        rows, columns = names_of(utilities)
        check_labels(rows, columns)
        names = names_or_numbers(rows if state_names is None else state_names, "s", states)
        action_names = columns if action_names is None else action_names
        super().__init__(prior, names, observations, state_numbers, signal_given_state)
        self.action_names = names_or_numbers(action_names, "a", actions)
        self.action_space = Discrete(actions)

    @property
    def stakes(self) -> float:
        """What the payoffs of a state differ by at most."""
        return (self.payoffs.amax(-1) - self.payoffs.amin(-1)).amax().item()

    @property
    def utility_range(self) -> float:
        """The largest utility less the smallest one that is not forbidden."""
        allowed = self.utilities[self.utilities.isfinite()]
        return (allowed.amax() - allowed.amin()).item()

    def utility(self, state: Tensor, action: Tensor) -> Tensor:
        """The payoff, float64, looked up in the table; see `Task.utility`."""
        return self.payoffs.to(state.device)[state, action]


def utility_table(task: Task, states: Tensor, actions: Tensor) -> Tensor:
    """U(ω, a) of all pairs, asked of the task.

    Args:
        task: What gives U(ω, a).
        states: ω, (W, …).
        actions: a, (A, …).

    Returns:
        (W, A), of whatever type the task gives.
    """
    if isinstance(task, FiniteTask):  # which broadcasts, and need not have the pairs spelt out
        return task.utility(states.unsqueeze(-1), actions)
    pairs = task.utility(
        states.repeat_interleave(len(actions), 0),
        actions.repeat(len(states), *[1] * (actions.ndim - 1)),
    )
    return pairs.reshape(len(states), len(actions))


def _payoffs(utilities: Tensor) -> Tensor:
    """The table with a finite penalty instead of −inf."""
    allowed = utilities[utilities.isfinite()]
    least, spread = allowed.amin(), allowed.amax() - allowed.amin()
    penalty = PENALTY * torch.where(spread > 0, spread, 1.0)
    return utilities.clamp(min=(least - penalty).item())


def names_or_numbers(names: Sequence[str] | None, prefix: str, count: int) -> tuple[str, ...]:
    """So many different names, made from a prefix if none are given."""
    if names is None:
        return tuple(f"{prefix}{i}" for i in range(count))
    listed = isinstance(names, Iterable) and not is_scalar(names)
    if not listed or not all(isinstance(n, str) and n.strip() for n in names):
        raise ValueError(f"names of {prefix}0, {prefix}1, … must be a list of text, got {names!r}")
    if len(names) != count:
        raise ValueError(f"expected {count} names for {prefix}0, {prefix}1, …, got {list(names)}")
    if len(set(names)) < count:
        raise ValueError(f"names must differ from each other, got {list(names)}")
    return tuple(names)
