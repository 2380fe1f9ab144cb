"""Streams of world-states, one batch per update."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import lightning.pytorch as pl
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from bra.checks.failures import find_note, named
from bra.checks.memory import check_memory
from bra.checks.settings import check_count, check_kind
from bra.processes.endings import end_with_trainer
from bra.processes.workers import how_ended, worker_context
from bra.randomness.draws import Streams
from bra.tasks.base import Block, Task, World, WorldError

TRAINING = "world"
"""The stream that updates draw their worlds from."""
WORKER = 2**27
"""Bytes that a worker takes at least."""


class RolloutDataModule(pl.LightningDataModule):
    """Streams `World` batches drawn by a task; an epoch is a number of updates.

    The batch of update k depends on the run's seed and on k alone: the stream is the same for
    any number of workers, and goes on where it was when a run is resumed. Seed and k are those of
    the trainer's `bra.Agent`. Every device gets the whole batch. Of a `bra.Population` every member
    has a stream of its own, the batch of its own seed; batches then have the shape (R, B, …).

    Args:
        task: What draws the worlds.
        batch_size: World-states per update.
        updates_per_epoch: Updates in one epoch.
        workers: Processes that draw ahead of the training; 0 draws in the training process, which
            is faster for tasks that only look up tables.
        evaluation_worlds: World-states in the one batch that validate, test and predict look at.

    Raises:
        TypeError: If the task is none.
        ValueError: If a number is too small, no whole number, or takes more memory than there is.
    """

    def __init__(
        self,
        task: Task,
        batch_size: int = 64,
        updates_per_epoch: int = 1000,
        workers: int = 0,
        evaluation_worlds: int = 1024,
    ) -> None:
        super().__init__()
        check_kind(task, Task, "task")
        if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
            raise ValueError(f"workers must be a whole number of at least 0, got {workers!r}")
        check_memory(WORKER * workers, f"workers {workers:,}")
        self.task = task
        self.batch_size = check_count(batch_size, "batch_size")
        self.updates_per_epoch = check_count(updates_per_epoch, "updates_per_epoch")
        self.workers = workers
        self.evaluation_worlds = check_count(evaluation_worlds, "evaluation_worlds")
        numbers = 1 + math.prod(task.observation_space.shape or ())
        for name in ("batch_size", "evaluation_worlds"):
            count = getattr(self, name)
            check_memory(4 * numbers * count, f"{name} {count:,}")

    def train_dataloader(self) -> "RolloutLoader":
        """Batches from the update at which the agent stands to the end of its epoch."""
        seeds = getattr(self._module(), "world_seeds", None) or self._seed()
        worlds = WorldStream(self.task, self.batch_size, seeds, TRAINING)
        return RolloutLoader(
            worlds,
            sampler=UpdateSampler(self._position, self.updates_per_epoch, self._block_end),
            batch_size=None,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            worker_init_fn=end_with_trainer,
            multiprocessing_context=worker_context(__name__) if self.workers else None,
        )

    def val_dataloader(self) -> "RolloutLoader":
        """One batch of held-back worlds."""
        return self._evaluation_loader("validation")

    def test_dataloader(self) -> "RolloutLoader":
        """One batch of held-back worlds, other than those of `val_dataloader`."""
        return self._evaluation_loader("test")

    def predict_dataloader(self) -> "RolloutLoader":
        """One batch of held-back worlds, other than those of the other loaders."""
        return self._evaluation_loader("predict")

    def _evaluation_loader(self, stream: str) -> "RolloutLoader":
        worlds = WorldStream(self.task, self.evaluation_worlds, self._seed(), stream)
        return RolloutLoader(worlds, sampler=UpdateSampler(lambda: range(1), 1), batch_size=None)

    def _seed(self) -> int:
        return getattr(self._module(), "seed", 0)

    def _position(self) -> range:
        """Numbers of the updates from where training stands to the end of the epoch.

        Modules that do not count their updates are taken to finish their epochs.
        """
        if self.trainer is None:
            return range(self.updates_per_epoch)
        finished = self.trainer.current_epoch * self.updates_per_epoch
        start = getattr(self._module(), "updates", finished)
        # Not zero only where a run is resumed within an epoch.
        done = self.trainer.fit_loop.epoch_loop.batch_progress.current.ready
        length = self.updates_per_epoch
        if self.trainer.num_training_batches < length:
            length = max(1, int(self.trainer.num_training_batches))
        return range(start, start + length - done % length)

    def _block_end(self, update: int, stop: int) -> int | None:
        ends = getattr(self._module(), "block_end", None)
        return ends(update, stop) if ends else None

    def _module(self) -> pl.LightningModule | None:
        return self.trainer.lightning_module if self.trainer else None


class WorldStream(Dataset[World | Block]):
    """Item k is the batch of world-states of update k; of several seeds, a stack of batches."""

    def __init__(self, task: Task, count: int, seed: int | Sequence[int], stream: str) -> None:
        self.task, self.count, self.stream = task, count, stream
        self.single = isinstance(seed, int)
        self.streams = Streams([seed] if isinstance(seed, int) else seed, stream)

    def __getitem__(self, update: int | range) -> World | Block:
        """The batch of an update, or the batches of several as a block."""
        if isinstance(update, range):
            return self._block(update)
        with named(f"in update {update}" if self.stream == TRAINING else f"in {self.stream}"):
            world = self.task.sample_streams(self.count, self.streams, update)
        return World(*(part[0] for part in world)) if self.single else world

    def _block(self, updates: range) -> Block:
        with named(f"in updates {updates.start} to {updates.stop - 1}"):
            world = self.task.sample_updates(self.count, self.streams, updates)
        world = World(*(part[:, 0] for part in world)) if self.single else world
        return Block(world, updates.start, len(updates))


class UpdateSampler(DistributedSampler[int]):
    """The numbers of the updates from where training stands to the end of the epoch.

    Being a `DistributedSampler` keeps Lightning from sharing them out among devices.
    """

    def __init__(
        self,
        position: Callable[[], range],
        updates_per_epoch: int,
        block_end: Callable[[int, int], int | None] = lambda update, stop: None,
    ) -> None:
        super().__init__(range(updates_per_epoch), num_replicas=1, rank=0)  # type: ignore[arg-type]  # asks len() only
        self.position = position
        self.updates_per_epoch = updates_per_epoch
        self.block_end = block_end

    def __iter__(self) -> Iterator[int | range]:  # type: ignore[override]  # some come as blocks
        """Starts at the current position; a range of updates is a block."""
        position = self.position()
        update = position.start
        while update < position.stop:
            end = self.block_end(update, position.stop)
            yield update if end is None else range(update, end)
            update = end or update + 1

    def __len__(self) -> int:
        """Updates of a whole epoch, by which Lightning counts also when it resumes within one."""
        return self.updates_per_epoch


class RolloutLoader(DataLoader[World | Block]):
    """A loader that says in one line why there are no more worlds.

    It can resume within an epoch, which Lightning tells by its two methods for states.
    """

    def __iter__(self) -> Iterator[World | Block]:  # type: ignore[override]  # Lightning asks for no more
        """Draws the batches in order.

        Raises:
            WorldError: If a worker died, or could not draw for a reason that it knows.
        """
        batches: Iterator[World | Block] | None = None
        while True:
            try:
                batches = batches or super().__iter__()  # starts, or restarts, the workers
                world = next(batches)
            except StopIteration:
                return
            except WorldError as error:
                raise _in_one_line(error) from error
            except (RuntimeError, ConnectionError, EOFError) as error:
                told = isinstance(error, RuntimeError) and "DataLoader worker (pid" not in str(
                    error
                )
                if told or find_note(error):
                    raise
                ended = how_ended(getattr(self._iterator or batches, "_workers", ()))
                raise WorldError(
                    f"a process that draws worlds {ended or f'is not to be reached: {error!r}'}"
                ) from error
            yield world

    def state_dict(self) -> dict[str, Any]:
        """Nothing: the position is the agent's number of updates."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to load."""


def _in_one_line(error: WorldError) -> WorldError:
    """The same without a worker's traceback."""
    note = find_note(error)
    *_, line = (line for line in str(error).strip().splitlines() if line != note)
    told = WorldError(line.removeprefix(f"{WorldError.__module__}.{WorldError.__qualname__}: "))
    if note:
        told.add_note(note)
    return told
