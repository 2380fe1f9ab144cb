"""What a training goes on from, beside weights: held against the state of one that begins."""

import copy
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from bra.checkpoints.files import CheckpointError

PARTS = ("optimizer_states", "lr_schedulers", "loops", "callbacks")
"""Of a checkpoint of Lightning."""


def check_training_state(
    checkpoint: dict[str, Any],
    optimizers: Sequence[Optimizer],
    schedulers: Sequence[LRScheduler],
    fit_loop: dict[str, Any],
) -> None:
    """Makes sure that a checkpoint holds what a training goes on from.

    Args:
        checkpoint: As it was read.
        optimizers: New ones, which are left alone.
        schedulers: New ones.
        fit_loop: State of a loop that has not begun.

    Raises:
        CheckpointError: If something is missing, of another kind or shape, not finite, or a
            negative number where there can be none.
    """
    if checkpoint.get("optimizer_states") is None:
        raise CheckpointError(
            "the checkpoint holds weights only, no optimizers to go on with; train anew"
        )
    begun = {
        "optimizer_states": list(map(state_of, optimizers)),
        "lr_schedulers": [scheduler.state_dict() for scheduler in schedulers],
        "loops": {"fit_loop": fit_loop},
        "callbacks": {},
    }
    for part in PARTS:
        if flaw := find_difference(checkpoint.get(part), begun[part], part):
            raise CheckpointError(
                f"the checkpoint's {flaw}: no state to go on from; take another one"
            )


def state_of(optimizer: Optimizer) -> dict[str, Any]:
    """Its state dict as it is after a step, which copies of its parameters make."""
    groups = []
    for group in optimizer.param_groups:
        copies = [nn.Parameter(p.detach().clone(), p.requires_grad) for p in group["params"]]
        for parameter in copies:
            parameter.grad = torch.zeros_like(parameter) if parameter.requires_grad else None
        groups.append(group | {"params": copies})
    stand_in = copy.copy(optimizer)
    stand_in.param_groups, stand_in.state = groups, type(optimizer.state)(dict)
    with suppress(Exception):  # what somebody's own makes of gradients of 0 is not of interest
        stand_in.step()
    return stand_in.state_dict()


def find_difference(saved: Any, like: Any, name: str) -> str:
    """Where a state is not of the kind of another, and how; empty if it is.

    Slots of an optimizer may be missing, as they are before the first step.
    """
    if isinstance(like, dict):
        if not isinstance(saved, dict):
            return f"{name} holds {_short(saved)}"
        if missing := [key for key in like if key not in saved and type(key) is not int]:
            return f"{name} lacks {missing[0]}"
        pairs = [(saved[key], part, f"{name}.{key}") for key, part in like.items() if key in saved]
        return _first(pairs)
    if isinstance(like, list | tuple):
        if not isinstance(saved, list | tuple) or len(saved) != len(like):
            return f"{name} holds {_short(saved)}"
        return _first(zip(saved, like, (f"{name}.{n}" for n in range(len(like))), strict=True))
    if isinstance(like, Tensor):
        same = isinstance(saved, Tensor) and saved.shape == like.shape
        fine = same and saved.is_floating_point() == like.is_floating_point()
        fine = fine and bool(saved.isfinite().all())
    elif isinstance(like, bool | str):
        fine = type(saved) is type(like)
    elif isinstance(like, int | float):
        kinds = int if isinstance(like, int) else (int, float)
        number = isinstance(saved, kinds) and not isinstance(saved, bool)
        fine = number and math.isfinite(saved) and (saved >= 0 or like < 0)
    else:
        fine = True
    return "" if fine else f"{name} holds {_short(saved)}"


def _first(triples: Iterable[tuple[Any, Any, str]]) -> str:
    return next(filter(None, (find_difference(*triple) for triple in triples)), "")


def _short(value: Any) -> str:
    if isinstance(value, Tensor):
        finite = "" if value.isfinite().all() else ", not all of it finite"
        return f"a tensor {tuple(value.shape)} of {value.dtype}{finite}"
    return f"{' '.join(repr(value).split()):.40}"
