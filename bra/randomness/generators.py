"""Torch's generators, for what draws by nothing else, seeded with the keys of updates."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Generator

from bra.randomness.keys import update_key


def counted_generator(seed: int, update: int, stream: str) -> Generator:
    """A CPU generator for what `update` draws from `stream`."""
    return Generator().manual_seed(update_key(seed, stream, update))


@contextmanager
def counted(seed: int, update: int, stream: str, device: torch.device) -> Iterator[None]:
    """Within, torch's default generators draw what belongs to `update` and `stream`.

    `torch.distributions` and `nn.init` know no other generator. Their former states come back on
    exit, so that a run neither sees nor disturbs anybody else's random numbers.

    Args:
        seed: The run's seed.
        update: Number of the update that draws.
        stream: Name of the stream that it draws from.
        device: Its generator is seeded too, if it has one.
    """
    generators = [torch.default_generator]
    if device.type == "cuda":
        index = torch.cuda.current_device() if device.index is None else device.index
        generators.append(torch.cuda.default_generators[index])
    states = [generator.get_state() for generator in generators]
    key = update_key(seed, stream, update)
    for generator in generators:
        generator.manual_seed(key)
    try:
        yield
    finally:
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)


@contextmanager
def drawing_by_default(device: torch.device) -> Iterator[Callable[[], bool]]:
    """Gives a function that says, afterwards, whether torch's default generators drew within.

    Their former states come back on exit.
    """
    states: list[list[torch.Tensor]] = []
    with counted(0, 0, "dry run", device):
        states.append(_states(device))
        yield lambda: not all(map(torch.equal, *states))
        states.append(_states(device))


def _states(device: torch.device) -> list[torch.Tensor]:
    states = [torch.default_generator.get_state()]
    if device.type == "cuda":
        states.append(torch.cuda.get_rng_state(device))
    return states
