"""What a noisy sensor leaves of a task: a problem whose states are the signals.

An agent sees ξ and not ω, so that its J is that of a task with prior p(ξ) and utilities
E[U(ω,a)|ξ] = Σ_ω p(ω|ξ) U(ω,a). What no agent attains without noise it attains no more with it:
what is coarser than the signals, cells of them say, can be told from them.
"""

from dataclasses import dataclass

import torch
from gymnasium.spaces import Box, Discrete
from torch import Tensor

from bra.randomness.generators import counted_generator
from bra.tasks.base import Task
from bra.tasks.finite import FiniteStateTask, FiniteTask

DRAWS = 2**20
"""Signals that are drawn to estimate p(ξ|ω)."""
PILOT = 256
"""Signals that are drawn to see whether they repeat."""
MOST_SIGNALS = 1024
"""Distinct signals beyond which they are put into cells."""
CELLS = {1: 2**8, 2: 2**8, 3: 2**9}
"""Cells of signals of one, two or three numbers."""


class UnknownSensorError(ValueError):
    """p(ξ|ω) is not known, and cannot be estimated."""


@dataclass(frozen=True)
class SignalTable:
    """p(s|ω) of finitely many signals, or cells of them.

    Attributes:
        signal_given_state: p(s|ω), (W, S), float64.
        draws: Signals of each state that it was estimated from; None if it is exact.
    """

    signal_given_state: Tensor
    draws: int | None = None

    def problem(self, task: FiniteTask) -> tuple[Tensor, Tensor]:
        """E[U(ω,a)|s], (S, A), of what agents are paid; and p(s), (S,)."""
        joint = task.prior[:, None] * self.signal_given_state
        mass = joint.sum(0)
        posterior = joint.T / torch.where(mass > 0, mass, 1.0)[:, None]
        return posterior @ task.payoffs, mass


def over_signals(task: Task) -> Task:
    """What agents see of a task whose noise is known: one whose states are the signals.

    Its sensor is noiseless. Others are returned as they are.
    """
    if not isinstance(task, FiniteTask) or task.signal_given_state is None:
        return task
    assert task._codes is not None  # as there are signals to be shown
    codes = "index" if isinstance(task.observation_space, Discrete) else task._codes.numpy()
    return FiniteTask(*SignalTable(task.signal_given_state).problem(task), observations=codes)


def signal_tables(task: FiniteStateTask, seed: int) -> list[SignalTable]:
    """p(s|ω) of a noisy sensor, the best table first; only that one if it is exact.

    What no task tells is counted in signals that are drawn: of each one, if they repeat; else of
    cells, which halve the signals again and again, along one of their numbers after the other. Of
    these a second table has half as many draws, and for cells a third half as many along each
    number. By how much J differs between them tells what it is worth.

    Raises:
        UnknownSensorError: If the task gives no p(s|ω), and a signal has more than three numbers
            and hardly ever comes again, such as an image.
    """
    if task.signal_given_state is not None:
        return [SignalTable(task.signal_given_state)]
    states, numbers = len(task.prior), _numbers(task)
    signals = _draw(task, -(-PILOT // states), seed)
    if numbers not in CELLS and len(torch.unique(signals, dim=0)) > len(signals) / 2:
        raise UnknownSensorError(
            f"a signal is {numbers} numbers that hardly ever come again, which leaves "
            f"p(signal|state) unknown; give {type(task).__name__} a signal_given_state"
        )
    each = 2 ** ((DRAWS // (states * -(-numbers // 4))).bit_length() - 1)
    signals = _draw(task, each, seed)
    distinct, index = torch.unique(signals, dim=0, return_inverse=True)
    if len(distinct) <= MOST_SIGNALS:
        return [_counted(index, states), _counted(index, states, each // 2)]
    if numbers not in CELLS:
        raise UnknownSensorError(
            f"the sensor has more than {MOST_SIGNALS} signals of {numbers} numbers, too many to "
            f"count; give {type(task).__name__} a signal_given_state"
        )
    index = _cells(signals, min(CELLS[numbers], each))
    coarser = index // 2**numbers
    return [_counted(index, states), _counted(index, states, each // 2), _counted(coarser, states)]


def _numbers(task: FiniteStateTask) -> int:
    """How many numbers a signal is."""
    space = task.observation_space
    return int(torch.Size(space.shape).numel()) if isinstance(space, Box) else 1


def _draw(task: FiniteStateTask, each: int, seed: int) -> Tensor:
    """Signals of all states, `each` per state, (W · each, numbers)."""
    state = torch.arange(len(task.prior)).repeat_interleave(each)
    signals = task.observe(state, counted_generator(seed, 0, "signals of the reference"))
    return signals.reshape(len(state), -1)


def _counted(index: Tensor, states: int, each: int | None = None) -> SignalTable:
    """Shares of the signals, from the first `each` draws of every state.

    Args:
        index: Which signal was drawn, (W · n,).
        states: W.
        each: Draws that count; None is all.
    """
    drawn = index.reshape(states, -1)[:, :each]
    count = int(index.max()) + 1
    flat = drawn + count * torch.arange(states)[:, None]
    counts = torch.bincount(flat.flatten(), minlength=states * count).reshape(states, count)
    return SignalTable(counts.double() / drawn.shape[1], drawn.shape[1])


def _cells(signals: Tensor, count: int) -> Tensor:
    """Which of `count` = 2^k cells of equally many signals each signal falls into, (N,).

    Signals are shuffled first, so that equal ones are shared out without regard to their states.
    """
    shuffle = torch.randperm(len(signals), generator=torch.Generator().manual_seed(0))
    cells = shuffle[None]
    while len(cells) < count:
        number = (len(cells).bit_length() - 1) % signals.shape[1]
        order = signals[cells, number].argsort(dim=1, stable=True)
        cells = cells.gather(1, order).reshape(2 * len(cells), -1)
    index = torch.empty(len(signals), dtype=torch.long)
    index[cells] = torch.arange(count)[:, None]
    return index
