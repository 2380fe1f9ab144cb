"""States of optimizers and schedules of torch go on from themselves, and from nothing else."""

from functools import partial

import pytest
import torch
from torch import nn
from torch.optim import SGD, Adafactor, Adagrad, Adam, AdamW, NAdam, RMSprop
from torch.optim import lr_scheduler as schedules

from bra.checkpoints.training import find_difference, state_of


def run(factory, updates, schedule=None):
    parameters = [nn.Parameter(torch.ones(3, 4)), nn.Parameter(torch.ones(2, 5))]
    optimizer = factory(parameters)
    scheduler = schedule(optimizer) if schedule else None
    for _ in range(updates):
        for parameter in parameters:
            parameter.grad = torch.ones_like(parameter)
        optimizer.step()
        if scheduler:
            scheduler.step()
    return optimizer, scheduler


@pytest.mark.parametrize(
    "factory",
    [
        *(partial(kind, lr=0.1) for kind in (SGD, Adam, AdamW, NAdam, Adagrad, RMSprop, Adafactor)),
        partial(SGD, lr=0.1, momentum=0.9),
        partial(Adam, lr=0.1, amsgrad=True, fused=True),
    ],
)
def test_optimizers_go_on_from_themselves(factory):
    new, _ = run(factory, 0)
    like = state_of(new)
    assert all((p == 1).all() for p in new.param_groups[0]["params"])
    for updates in (0, 5):
        assert not find_difference(run(factory, updates)[0].state_dict(), like, "optimizer")
    assert find_difference(run(partial(Adam, maximize=1), 5)[0].state_dict(), like, "optimizer")


@pytest.mark.parametrize(
    "schedule",
    [
        partial(schedules.StepLR, step_size=2),
        partial(schedules.MultiStepLR, milestones=[2, 4]),
        partial(schedules.CosineAnnealingWarmRestarts, T_0=3),
        partial(schedules.OneCycleLR, max_lr=0.1, total_steps=50),
        partial(schedules.CyclicLR, base_lr=0.1, max_lr=0.2),
        schedules.LinearLR,
    ],
)
def test_schedules_go_on_from_themselves(schedule):
    optimizers, found = zip(
        *(run(partial(SGD, lr=0.1, momentum=0.9), n, schedule) for n in (7, 0)), strict=True
    )
    saved, like = (scheduler.state_dict() for scheduler in found)
    assert not find_difference(saved, like, "schedule")
    assert not find_difference(optimizers[0].state_dict(), state_of(optimizers[1]), "optimizer")
    for wrong in ("x", -3, 1.5, None, float("nan")):
        said = find_difference(saved | {"last_epoch": wrong}, like, "schedule")
        assert said == f"schedule.last_epoch holds {wrong!r}"
