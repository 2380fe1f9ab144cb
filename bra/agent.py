"""The agent: perception and action in series, trained on J."""

import copy
import math
import operator
import os
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Self, cast

import lightning.pytorch as pl
import torch
from gymnasium.spaces import Box, Discrete, Space
from lightning.pytorch.core.optimizer import LightningOptimizer
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor, nn
from torch.nn.utils import get_total_norm
from torch.optim import LBFGS, Adam, Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau

from bra import checkpoints
from bra.channels import MLP, Channel, Multinomial
from bra.channels.base import check_channel
from bra.checks import check_beta, check_count
from bra.cooling import Cooling
from bra.evaluation import Evaluation, evaluate_channels
from bra.marginals import Marginals, default_marginals
from bra.objective import Objective, evaluation_metrics
from bra.randomness import counted, counted_generator
from bra.recipes import Recipe, describe_recipe, from_recipe, same_recipe, to_recipe
from bra.tasks import FiniteStateTask, FiniteTask, Rollout, Task, World
from bra.update_rules import Chain, ScoreFunction, UpdateRule

ChannelFactory = Callable[[Space[Any], Space[Any]], Channel]
OptimizerFactory = Callable[[Iterable[Any]], Optimizer]
SchedulerFactory = Callable[[Optimizer], LRScheduler]

EVALUATION_WORLDS = 1024
DIVERGED = 1e30
"""Size of a parameter beyond which sums of float32 products overflow."""

DEFAULT_PERCEPTION_OPTIMIZER = partial(Adam, lr=0.003)
DEFAULT_ACTION_OPTIMIZER = partial(Adam, lr=0.03)


class Agent(pl.LightningModule):
    """Maximises J = E[U] − I(Ω;X)/β₁ − I(X;A)/β₂ over a perception and an action channel.

    One training step is one update of both channels. `trainer.global_step`, and with it
    `max_steps`, checkpoint intervals and logged steps, counts updates.

    Args:
        task: World and utility.
        perception: Makes p(x|ξ) from (observation space, percept space): a `Channel` class, or a
            `functools.partial` of one.
        action: Makes p(a|x) from (percept space, action space).
        percepts: |X|, or the percept space.
        beta_perception: β₁, inverse price of I(Ω;X), per nat.
        beta_action: β₂, inverse price of I(X;A), per nat.
        update_rule: How encounters move the channels; None is `ScoreFunction()`.
        perception_optimizer: Makes the optimizer of the perception channel's parameters.
        action_optimizer: Makes the optimizer of the action channel's parameters.
        perception_scheduler: Makes a learning-rate schedule, stepped once per update.
        action_scheduler: The same for the action channel.
        marginals: The way to p(x) and p(a); None is exact where the task's states are known,
            running averages for other tasks with discrete percepts, else the batch's.
        cooling: How the prices that updates see approach β₁ and β₂; None keeps them there.
        seed: Of the initial channels and of all that updates draw. None takes a number from
            torch's default generator.

    Attributes:
        updates: Updates made so far; part of every checkpoint.
        samples: World-states drawn so far; part of every checkpoint.
        terms: The terms of J as the last update saw them.

    Raises:
        TypeError: If a factory makes something other than a channel, or a channel's forward
            returns no distribution.
        ValueError: If a price is not positive and finite, `percepts` less than 1, spaces do not
            fit, or rule or marginals cannot work with these channels.
    """

    def __init__(
        self,
        task: Task,
        perception: ChannelFactory = MLP,
        action: ChannelFactory = Multinomial,
        percepts: int | Discrete | Box = 2,
        beta_perception: float = 1.0,
        beta_action: float = 1.0,
        update_rule: UpdateRule | None = None,
        perception_optimizer: OptimizerFactory = DEFAULT_PERCEPTION_OPTIMIZER,
        action_optimizer: OptimizerFactory = DEFAULT_ACTION_OPTIMIZER,
        perception_scheduler: SchedulerFactory | None = None,
        action_scheduler: SchedulerFactory | None = None,
        marginals: Marginals | None = None,
        cooling: Cooling | None = None,
        seed: int | None = None,
    ) -> None:
        super().__init__()
        self.automatic_optimization = False
        self.task = task
        self.beta_perception = check_beta(beta_perception, "beta_perception")
        self.beta_action = check_beta(beta_action, "beta_action")
        self.percept_space = (
            percepts
            if isinstance(percepts, Discrete | Box)
            else Discrete(check_count(percepts, "percepts"))
        )
        self.seed = int(torch.randint(2**31, ())) if seed is None else operator.index(seed)
        self.cooling = cooling
        self.updates = 0
        self.samples = 0
        self.terms: Objective[Tensor] | None = None
        self._held_back: World | None = None

        self.perception = self._make_channel(
            "perception", perception, task.observation_space, self.percept_space
        )
        self.action = self._make_channel("action", action, self.percept_space, task.action_space)
        # Copies, since both may have a state that belongs to this agent alone.
        self.marginals = copy.deepcopy(marginals) or default_marginals(task, self.percept_space)
        self.marginals.check(task, self.percept_space)
        self.update_rule = copy.deepcopy(update_rule) or ScoreFunction()
        self.update_rule.check(self.chain)
        self.optimizer_factories = (perception_optimizer, action_optimizer)
        self.scheduler_factories = (perception_scheduler, action_scheduler)
        self.configure_optimizers()  # so that wrong settings are refused here and not in fit()
        self.recipe: dict[str, Recipe] = {
            "task": to_recipe(task),
            "perception": to_recipe(perception),
            "action": to_recipe(action),
            "percepts": to_recipe(self.percept_space),
            "beta_perception": self.beta_perception,
            "beta_action": self.beta_action,
            "update_rule": to_recipe(self.update_rule),
            "perception_optimizer": to_recipe(perception_optimizer),
            "action_optimizer": to_recipe(action_optimizer),
            "perception_scheduler": to_recipe(perception_scheduler),
            "action_scheduler": to_recipe(action_scheduler),
            "marginals": to_recipe(self.marginals),
            "cooling": to_recipe(cooling),
            "seed": self.seed,
        }

    def _make_channel(
        self, place: str, factory: ChannelFactory, condition: Space[Any], outcome: Space[Any]
    ) -> Channel:
        if isinstance(factory, nn.Module):
            raise TypeError(
                f"{place} must make a channel, got one that is made; pass its class, or a "
                "functools.partial of it"
            )
        with counted(self.seed, 0, place, torch.device("cpu")):
            try:
                channel = factory(condition, outcome)
                check_channel(channel)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{place}: {error}") from error
        return channel

    @property
    def chain(self) -> Chain:
        """What the update rule trains, at the prices of the coming update."""
        scale = self.cooling.scale(self.updates) if self.cooling else 1.0
        return Chain(
            self.task,
            self.perception,
            self.action,
            self.marginals,
            scale * self.beta_perception,
            scale * self.beta_action,
        )

    def configure_optimizers(self) -> tuple[list[Optimizer], list[LRScheduler]]:
        """One optimizer per channel, and the schedulers asked for."""
        channels = (self.perception, self.action)
        names = ("perception_optimizer", "action_optimizer")
        optimizers = []
        for name, factory, channel in zip(names, self.optimizer_factories, channels, strict=True):
            try:
                optimizer = factory(channel.parameters())
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
            if isinstance(optimizer, LBFGS):
                raise ValueError(
                    f"{name}: LBFGS needs the loss several times per update; use another optimizer"
                )
            optimizers.append(optimizer)
        schedulers = [
            factory(optimizer)
            for factory, optimizer in zip(self.scheduler_factories, optimizers, strict=True)
            if factory is not None
        ]
        for scheduler in schedulers:
            if isinstance(scheduler, ReduceLROnPlateau):
                raise ValueError(
                    "ReduceLROnPlateau waits for a metric, schedules here follow the updates; use "
                    "another scheduler"
                )
        return optimizers, schedulers

    def on_fit_start(self) -> None:
        """Makes sure that the worlds are those of the agent's task.

        Raises:
            ValueError: If the data module draws from another task.
        """
        task = getattr(getattr(self.trainer, "datamodule", None), "task", self.task)
        if task is not self.task and not same_recipe(to_recipe(task), self.recipe["task"]):
            raise ValueError(
                f"the data module draws worlds of {describe_recipe(to_recipe(task))}, the agent's "
                f"task is {describe_recipe(self.recipe['task'])}; give both the same task"
            )

    def training_step(self, world: World, batch_idx: int) -> None:
        """Makes one update of both channels."""
        optimizers = cast(list[LightningOptimizer], self.optimizers())
        place = f"update {self.global_rank}" if self.global_rank else "update"
        with counted(self.seed, self.updates, place, self.device):
            loss, self.terms = self.update_rule.loss(self.chain, world)
        for optimizer in optimizers:
            optimizer.zero_grad()
        self.manual_backward(loss)
        self._step(optimizers)
        self._check_parameters()
        self.updates += 1
        self.samples += len(world.state) * self.trainer.world_size

    def _step(self, optimizers: list[LightningOptimizer]) -> None:
        perception, action = optimizers
        perception.step()
        # Lightning counts each LightningOptimizer.step() as one global step. The second
        # optimizer goes through the strategy directly, so that one update is one step.
        self.trainer.strategy.optimizer_step(action.optimizer, closure=_no_closure)
        for scheduler in self._schedulers():
            scheduler.step()

    def _schedulers(self) -> list[LRScheduler]:
        schedulers = self.lr_schedulers() or []
        return schedulers if isinstance(schedulers, list) else [schedulers]

    def _check_parameters(self) -> None:
        """Stops before a checkpoint could hold NaN."""
        for name, channel in (("perception", self.perception), ("action", self.action)):
            parameters = [parameter for parameter in channel.parameters() if parameter.numel()]
            if parameters and not get_total_norm(parameters, norm_type=math.inf) < DIVERGED:
                raise FloatingPointError(
                    f"the {name} channel's parameters ran away (NaN, or beyond {DIVERGED:g}) in "
                    f"update {self.updates}; lower its learning rate"
                )

    def validation_step(self, world: World, batch_idx: int) -> None:
        """Logs J and its terms."""
        self._log_evaluation(world)

    def test_step(self, world: World, batch_idx: int) -> None:
        """Logs J and its terms."""
        self._log_evaluation(world)

    def predict_step(self, world: World, batch_idx: int) -> Rollout:
        """Acts in every world of the batch."""
        with counted(self.seed, self.updates, f"predict {batch_idx}", self.device):
            percept, action = self.act(world.observation)
            return Rollout(*world, percept, action, self.task.utility(world.state, action))

    def _log_evaluation(self, world: World) -> None:
        # During fit, the information monitor writes the curves; here only callbacks listen.
        self.log_dict(
            evaluation_metrics(self.evaluation(world).objective),
            logger=self.trainer.state.fn != TrainerFn.FITTING,
            batch_size=1,
        )

    @torch.no_grad()
    def act(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Perceives and acts.

        Args:
            observation: ξ, (*batch,) for `Discrete` observations, (*batch, *shape) for a `Box`.

        Returns:
            Percept x ~ p(x|ξ) and action a ~ p(a|x), (*batch, …).
        """
        percept = self.perception(observation).sample()
        return percept, self.action(percept).sample()

    def behaviour(self) -> Tensor:
        """p(a|ω) = Σ_x p(x|ω) p(a|x), (W, A), float64.

        Raises:
            TypeError: If the task's states and actions are not finite.
        """
        if not isinstance(self.task, FiniteTask):
            raise TypeError(
                f"behaviour() tabulates p(a|ω) and needs a FiniteTask, got "
                f"{type(self.task).__name__}; use act()"
            )
        return self.evaluation().action_given_state

    def evaluate(self) -> Objective[float]:
        """J and its terms: exact for discrete percepts of a noiseless sensor, else estimated.

        See `bra.evaluation.evaluate_channels` for the estimates and their bias.
        """
        return self.evaluation().objective

    def evaluation(self, world: World | None = None) -> Evaluation:
        """J, its terms, and the channels as tables.

        Args:
            world: Worlds to estimate from, where the task's states are not known or its sensor is
                noisy; None takes 1024 that no update sees, the same every time.
        """
        task = self.task
        prior = task.prior if isinstance(task, FiniteStateTask) else None
        if isinstance(task, FiniteStateTask) and task.noiseless:
            world = task.states()
        elif world is None:
            world = self._held_back_worlds()
        training = self.training
        self.eval()
        try:
            with counted(self.seed, self.updates, "evaluation", self.device):
                return evaluate_channels(
                    self.task,
                    self.perception,
                    self.action,
                    self.beta_perception,
                    self.beta_action,
                    World(*(part.to(self.device) for part in world)),
                    prior,
                )
        finally:
            self.train(training)

    def _held_back_worlds(self) -> World:
        """Worlds to estimate from, drawn once: of known states equally many signals each."""
        if self._held_back is None:
            generator = counted_generator(self.seed, 0, "evaluation world")
            if isinstance(self.task, FiniteStateTask):
                states = len(self.task.prior)
                each = max(2, EVALUATION_WORLDS // states)
                state = torch.arange(states).repeat_interleave(each)
                self._held_back = World(state, self.task.observe(state, generator))
            else:
                self._held_back = self.task.sample(EVALUATION_WORLDS, generator)
        return self._held_back

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Adds counters and the recipe of the agent."""
        if "loops" in checkpoint:
            checkpoints.reopen_epoch(checkpoint["loops"]["fit_loop"])
        checkpoint[checkpoints.KEY] = {
            "updates": self.updates,
            "samples": self.samples,
            "recipe": self.recipe,
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Takes over counters and seed.

        Raises:
            ValueError: If the checkpoint is of another task or other channels.
        """
        saved = checkpoint[checkpoints.KEY]
        checkpoints.check_same_parts(saved["recipe"], self.recipe)
        self.updates, self.samples = saved["updates"], saved["samples"]
        self.seed = self.recipe["seed"] = saved["recipe"]["seed"]

    @classmethod
    def load_from_checkpoint(  # type: ignore[override]  # Lightning's options do not apply
        cls,
        checkpoint_path: str | os.PathLike[str],
        map_location: Any = None,
        **overrides: Any,
    ) -> Self:
        """Rebuilds the agent that a checkpoint holds, with `weights_only=True`.

        Args:
            checkpoint_path: Path of the checkpoint.
            map_location: As for `torch.load`.
            overrides: Arguments of `Agent` to take instead of the saved ones, such as other
                prices, or a task or channel whose class cannot be imported here.

        Raises:
            ValueError: If the file is no checkpoint of an agent, or names a class that cannot be
                imported or has no place in an agent.
        """
        checkpoint = checkpoints.read_checkpoint(checkpoint_path, map_location)
        saved = checkpoint[checkpoints.KEY]
        kept = {part: recipe for part, recipe in saved["recipe"].items() if part not in overrides}
        agent = cls(**from_recipe(kept), **overrides)
        agent.load_state_dict(checkpoint["state_dict"])
        agent.updates, agent.samples = saved["updates"], saved["samples"]
        return agent


def _no_closure() -> None:
    return None
