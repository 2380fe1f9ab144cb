"""The worlds that agents are judged by."""

import torch

from bra.randomness import counted_generator
from bra.tasks import FiniteStateTask, Task, World, knows_signals
from bra.tasks.base import check_world

EVALUATION_WORLDS = 1024


def evaluation_worlds(task: Task, seed: int) -> World:
    """Worlds to evaluate on: all states where the sensor is noiseless, else worlds drawn for it.

    Of known states equally many signals are drawn each. They are the same for the same seed, and
    others than any update draws.
    """
    if knows_signals(task):
        return task.states()
    generator = counted_generator(seed, 0, "evaluation world")
    if not isinstance(task, FiniteStateTask):
        world = task.sample(EVALUATION_WORLDS, generator)
        return check_world(task, world, EVALUATION_WORLDS)
    states = len(task.prior)
    each = max(2, EVALUATION_WORLDS // states)
    state = torch.arange(states).repeat_interleave(each)
    return World(state, task.observe(state, generator))
