"""Where blocks of updates end, and how Lightning counts them.

To Lightning a block is one batch. Its counters, of batches and of steps, are moved on by the
updates in it, so that `global_step`, intervals, checkpoints and the position within the epoch are
what they are when updates are made one by one.
"""

import math
from collections.abc import Iterator

import lightning.pytorch as pl
from lightning.pytorch.callbacks import (
    LearningRateMonitor,
    ModelCheckpoint,
    ProgressBar,
    Timer,
)

HOOKS = (
    "on_train_batch_start",
    "on_train_batch_end",
    "on_before_zero_grad",
    "on_before_backward",
    "on_after_backward",
    "on_before_optimizer_step",
)
"""What is called at every update."""
UPDATES = (
    *("training_step", "find_gradient", "update_loss", "coming_chain", "prices"),
    *("back_propagate", "backward", "optimizer_step", "lr_scheduler_step"),
)
"""Of what an update is made, where updates are made one by one."""
UNKNOWN = object()


def own_updates(cls: type) -> str:
    """What a class derived from ours has of its own of an update; empty if nothing."""
    for base in cls.__mro__:
        if base.__module__.startswith("bra."):
            return ""
        for name in (*HOOKS, *UPDATES):
            if name in vars(base):
                return f"{base.__name__}.{name}"
    return ""


def who_looks_at_all(trainer: pl.Trainer) -> str:
    """The first that has to see every single update; empty if nobody has.

    Callbacks say by an attribute `every_n_updates` at which updates they look, None if at any.
    """
    for callback in trainer.callbacks:  # type: ignore[attr-defined]  # set by the connector
        known = isinstance(callback, ModelCheckpoint | ProgressBar | Timer | LearningRateMonitor)
        if known or getattr(callback, "every_n_updates", UNKNOWN) is not UNKNOWN:
            continue
        if any(getattr(type(callback), hook) is not getattr(pl.Callback, hook) for hook in HOOKS):
            return type(callback).__name__
    return ""


def updates_until_look(trainer: pl.Trainer, updates: int, ahead: int) -> float:
    """Updates until somebody looks at the learner, or the run ends; inf if nobody ever does.

    Args:
        trainer: Runs the callbacks.
        updates: That the learner has made.
        ahead: Updates that are drawn and not made yet.
    """
    step = trainer.global_step + ahead
    left = trainer.max_steps - step if trainer.max_steps >= 0 else math.inf
    clocks = _clocks(trainer, updates, trainer.global_step)
    return min([left, *(every - (count + ahead) % every for every, count in clocks)])


def _clocks(trainer: pl.Trainer, updates: int, step: int) -> Iterator[tuple[int, int]]:
    """Intervals, and how far the count is that they are of."""
    for callback in trainer.callbacks:  # type: ignore[attr-defined]
        if every := getattr(callback, "every_n_updates", None):
            yield every, updates
        if isinstance(callback, ModelCheckpoint) and callback._every_n_train_steps > 0:
            yield callback._every_n_train_steps, step
        if isinstance(callback, LearningRateMonitor):
            yield trainer.log_every_n_steps, step  # type: ignore[attr-defined]
    every = trainer.val_check_batch
    if trainer.enable_validation and every is not None and every < math.inf:
        progress = trainer.fit_loop.epoch_loop.batch_progress
        count = progress.total if trainer.check_val_every_n_epoch is None else progress.current
        yield int(every), count.ready


def count_batches(trainer: pl.Trainer, more: int) -> None:
    """Counts updates of a block beyond the first, which Lightning counts itself."""
    loop, fetcher = trainer.fit_loop.epoch_loop, trainer.fit_loop._data_fetcher
    for count in (loop.batch_progress.total, loop.batch_progress.current):
        for stage in ("ready", "started", "processed", "completed"):
            setattr(count, stage, getattr(count, stage) + more)
    loop._batches_that_stepped += more
    if fetcher is not None and fetcher.length is not None:
        fetcher.fetched += more
        fetcher.done = fetcher.fetched >= fetcher.length
        loop.batch_progress.is_last_batch = fetcher.done


def count_steps(trainer: pl.Trainer, steps: int) -> None:
    """Counts steps of the optimizers that were made without them."""
    progress = trainer.fit_loop.epoch_loop.manual_optimization.optim_step_progress
    for count in (progress.total, progress.current):
        count.ready += steps
        count.completed += steps
