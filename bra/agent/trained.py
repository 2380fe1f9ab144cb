"""How both channels move: update by update, or many updates in one call of compiled code."""

import logging
import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, Literal, cast

import torch
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from bra.agent.boundaries import (
    count_batches,
    count_steps,
    own_updates,
    updates_until_look,
    who_looks_at_all,
)
from bra.agent.optimizers import (
    DIVERGED,
    OptimizerFactory,
    SchedulerFactory,
    make_optimizers,
    make_schedulers,
    step_schedules,
)
from bra.agent.resumable import Resumable
from bra.agent.settings import Setting
from bra.agent.trainers import clip_gradients
from bra.blocks import Blocks, Many, Untraceable
from bra.blocks.modules import Modules
from bra.blocks.optimizers import has_slots
from bra.blocks.recording import Clip
from bra.budgets import Budgets
from bra.channels import Channel
from bra.marginals import Marginals
from bra.objective import Objective
from bra.tasks import Task, World
from bra.tasks.base import Block
from bra.update_rules import UpdateRule

logger = logging.getLogger(__name__)

Compile = bool | Literal["auto"]

UPDATE = "update"
"""The stream that updates draw from, see `bra.randomness`: on every device the same."""
PAYS = 20_000
"""Updates of a run from which on compiling is won back, also by large populations."""


def check_compile(compile: Any) -> Compile:
    """The setting, if it is one.

    Raises:
        ValueError: If it is none.
    """
    if compile not in (True, False, "auto"):
        raise ValueError(f"compile must be auto, true or false, got {compile!r}")
    return cast(Compile, compile)


class Trained(Resumable):
    """Moves a perception and an action channel by one optimizer each.

    With `compile`, updates are made in blocks: worlds of many updates are drawn at once, and loss,
    gradient and steps of all of them are one call of compiled code (`bra.blocks`). A block ends
    where somebody looks: a monitor, a checkpoint, validation, the end of the epoch. Seeds give the
    same agent for any length of blocks, bit by bit. What cannot be compiled is trained update by
    update, which is said in one line.

    Attributes:
        task: World and utility.
        perception: p(x|ξ).
        action: p(a|x).
        marginals: The way to p(x) and p(a).
        update_rule: How encounters move the channels.
        optimizer_factories: Make the optimizer of each channel's parameters.
        scheduler_factories: Make the learning-rate schedule of each, or None.
        compiled: Whether updates are made in blocks; "auto" where a run is long enough to win back
            the compilation.
        budgets: What prices follow, or None.
        terms: The terms of J as the last update saw them.
    """

    task: Task
    perception: Channel
    action: Channel
    marginals: Marginals
    update_rule: UpdateRule
    optimizer_factories: tuple[OptimizerFactory, OptimizerFactory]
    scheduler_factories: tuple[SchedulerFactory | None, SchedulerFactory | None]
    compiled: Compile
    budgets: Budgets | None
    stacked: ClassVar[bool] = False
    """Whether the first dimension of parameters counts agents."""

    def __init__(self) -> None:
        super().__init__()
        self.automatic_optimization = False
        self.terms: Objective[Tensor] | None = None
        self._blocks: Blocks | None = None

    def configure_optimizers(self) -> tuple[list[Optimizer], list[LRScheduler]]:
        """One optimizer per channel, and the schedulers asked for."""
        channels = (self.perception.parameters(), self.action.parameters())
        optimizers = make_optimizers(self.optimizer_factories, channels)
        return optimizers, make_schedulers(self.scheduler_factories, optimizers)

    def modules_of_chain(self) -> Modules:
        """Task, channels, marginals, rule and budgets as one module, which shares their state."""
        parts = (self.task, self.perception, self.action, self.marginals, self.update_rule)
        return Modules(*parts, self.budgets)

    @property
    @abstractmethod
    def settings(self) -> tuple[Setting, ...]:
        """Seed, prices and rates of every agent."""

    @abstractmethod
    def find_gradient(self, world: World) -> None:
        """Puts the gradient of the coming update in place of the last, and its terms in `terms`."""

    def back_propagate(self, loss: Tensor) -> None:
        """Puts the gradient of a loss in place of the last one; in a run, the trainer does."""
        self.zero_grad()
        if self._trainer is None:
            loss.backward()  # type: ignore[no-untyped-call]
        else:
            self.manual_backward(loss)

    @abstractmethod
    def _own_terms(self, terms: dict[str, Tensor]) -> Objective[Tensor]:
        """Terms of J, (R,) each, as `terms` has them."""

    @property
    def _clip(self) -> Clip | None:
        """Clips the gradients of one agent's channel, if they are to be clipped."""
        if not self.trainer.gradient_clip_val:
            return None
        return partial(clip_gradients, self.trainer, stacked=False)

    @abstractmethod
    def all_agents(self, optimizers: Sequence[Optimizer], clip: Clip | None) -> Many:
        """All agents, for a block of their updates.

        Args:
            optimizers: Of perception and action.
            clip: Clips the gradients of one agent's channel in place, or None.
        """

    @abstractmethod
    def _prices_along(self, updates: range) -> Tensor:
        """β₁, β₂ and, where there is one, β₃ of each update and agent, (n, k, R), float64."""

    def training_step(self, batch: World | Block, batch_idx: int) -> None:
        """Makes one update of both channels, or a block of them."""
        if not isinstance(batch, Block):
            self._make_update(batch)
            return
        if self._blocks is not None:
            try:
                self._make_block(batch, self._blocks)
            except Untraceable as reason:
                self._train_one_by_one(str(reason))
        if self._blocks is None:  # also of batches that were drawn before that was known
            for index in range(batch.updates):
                self._make_update(batch.at(index))
        count_batches(self.trainer, batch.updates - 1)

    def prepare_blocks(self) -> None:
        """Finds out whether updates of the coming run are made in blocks."""
        self._blocks = None
        if self.compiled is True or (self.compiled == "auto" and (self.run or 0) >= PAYS):
            self._blocks = Blocks(self._world_numbers())
            if reason := self._why_one_by_one():
                self._train_one_by_one(reason)

    def _why_one_by_one(self) -> str:
        trainer = self.trainer
        if trainer.world_size > 1:
            return "several devices train"
        if getattr(trainer.precision_plugin, "scaler", None) is not None:
            return "losses are scaled"
        if own := own_updates(type(self)):
            return f"{own} is somebody's own"
        looks = who_looks_at_all(trainer)
        return f"{looks} is called at every update" if looks else ""

    def _train_one_by_one(self, reason: str) -> None:
        self._blocks = None
        if self.trainer.is_global_zero:
            logger.info("updates are made one by one, uncompiled: %s", reason)

    def block_end(self, update: int, stop: int) -> int | None:
        """End of the block that `update` begins; None if it is made by itself, uncompiled.

        Args:
            update: Number of an update that is not drawn yet.
            stop: Number of the first update after the epoch.
        """
        optimizers = [o.optimizer for o in cast(list[LightningOptimizer], self.optimizers())]
        if self._blocks is None or not all(map(has_slots, optimizers)):
            return None
        ahead = update - self.updates
        if self._schedulers() and not self.trainer.global_step + ahead:
            return None  # schedules look whether an optimizer has stepped before them
        count = updates_until_look(self.trainer, self.updates, ahead)
        return min(stop, update + int(min(count, self._blocks.longest)))

    def _world_numbers(self) -> int:
        """Numbers that the worlds of an update are made of, of all agents."""
        batch = getattr(getattr(self.trainer, "datamodule", None), "batch_size", 1)
        signal = math.prod(self.task.observation_space.shape or ())
        return int(batch * (signal + 1) * (len(self.settings) if self.stacked else 1))

    def _make_update(self, world: World) -> None:
        self.find_gradient(world)
        self._step(cast(list[LightningOptimizer], self.optimizers()))
        self._check_parameters(f"update {self.updates}")
        self._follow_budgets()
        self.updates += 1
        self.samples += self._count(world)

    def _follow_budgets(self) -> None:
        """Moves prices that follow budgets by what the update saw, on all devices."""
        if self.budgets:
            assert self.terms is not None  # the update has just left them
            rates = self.terms.perception_information, self.terms.action_information
            seen = [self.trainer.strategy.reduce(rate, reduce_op="mean") for rate in rates]
            self.budgets.follow(seen, self.updates)

    def _make_block(self, block: Block, blocks: Blocks) -> None:
        optimizers = [o.optimizer for o in cast(list[LightningOptimizer], self.optimizers())]
        updates = range(block.first, block.first + block.updates)
        prices = self._prices_along(updates).to(self.device, torch.get_default_dtype())
        agents = self.all_agents(optimizers, self._clip)
        rates = partial(self._rates_along, optimizers, updates)
        terms = blocks.make(agents, block, prices, rates)
        self.terms = self._own_terms(terms)
        count_steps(self.trainer, block.updates)
        self._check_parameters(f"updates {updates[0]} to {updates[-1]}")
        self.updates += block.updates
        self.samples += block.updates * self._count(block.at(0))

    def _rates_along(self, optimizers: Sequence[Optimizer], updates: range) -> Tensor:
        """Learning rates of each update, (n, 2); steps the schedules."""
        schedulers = self._schedulers()
        rates = []
        for _ in updates:
            rates.append([float(o.param_groups[0]["lr"]) for o in optimizers])
            if not schedulers:
                rates *= len(updates)
                break
            step_schedules(schedulers)
        return torch.tensor(rates, dtype=torch.get_default_dtype(), device=self.device)

    def _count(self, world: World) -> int:
        """World-states in a batch."""
        return len(world.state)

    def _step(self, optimizers: list[LightningOptimizer]) -> None:
        perception, action = optimizers
        for optimizer in (perception, action):
            parameters = [p for group in optimizer.param_groups for p in group["params"]]
            gradients = [p.grad for p in parameters if p.grad is not None]
            clip_gradients(self.trainer, gradients, self.stacked)
        perception.step()
        # Lightning counts each LightningOptimizer.step() as one global step. The second
        # optimizer goes through the strategy directly, so that one update is one step.
        self.trainer.strategy.optimizer_step(action.optimizer, closure=_no_closure)
        step_schedules(self._schedulers())

    def _schedulers(self) -> list[LRScheduler]:
        schedulers = self.lr_schedulers() or []
        return schedulers if isinstance(schedulers, list) else [schedulers]

    def _check_parameters(self, when: str) -> None:
        """Stops before a checkpoint could hold NaN."""
        for name, channel in (("perception", self.perception), ("action", self.action)):
            parameters = [p.detach() for p in channel.parameters() if p.numel()]
            extremes = [value for p in parameters for value in (p.amax(), -p.amin())]
            if extremes and not torch.stack(extremes).amax() < DIVERGED:
                raise FloatingPointError(
                    f"the {name} channel's parameters ran away (NaN, or beyond {DIVERGED:g}) in "
                    f"{when}{self._whose(channel)}; lower its learning rate"
                )

    def _whose(self, channel: Channel) -> str:
        """Whose parameters ran away, where there is more than one agent."""
        return ""


def _no_closure() -> None:
    return None
