"""Many agents trained as one."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor
from torch.optim import Optimizer

from bra.agent.agent import Agent
from bra.agent.defaults import Parts, choose, chosen_line
from bra.agent.optimizers import NAMES, OptimizerFactory
from bra.agent.settings import Setting, Values, expand_settings
from bra.agent.trained import UPDATE, Compile, check_compile
from bra.blocks import Many
from bra.blocks.recording import Clip
from bra.budgets import cheap
from bra.checkpoints import files as checkpoints
from bra.checkpoints.recipes import Recipe, to_recipe
from bra.checks.settings import check_count, check_flag, check_seed
from bra.objective import Objective
from bra.population.loss import StackedLoss
from bra.population.members import Members
from bra.population.optimizers import scale_steps, stacked_factory, with_rate
from bra.population.prices import Prices
from bra.population.stack import Stack
from bra.randomness.keys import stream_keys
from bra.tasks import Task, World


class Population(Members):
    """R agents that differ in seed, prices or budgets, and learning rates, trained as one batch.

    Every member goes the way that `Agent` goes with its seed and its settings. An update of the
    population is one update of every member: one loss over tensors with a leading dimension R
    (`torch.func.vmap`), one backward pass, one step of each channel's optimizer. `state_dict` has
    an agent's names, and R in front of every shape.

    Prices, budgets and rates may be lists. Lists of the same length are walked through side by
    side, with `grid` all their combinations are taken; and each of these is trained with `replicas`
    seeds. The prices of every member follow its own budgets.

    Asked to act or to be evaluated, a population answers with its best member: the one of
    highest J, where prices follow budgets B of highest E[U] − (I − B)/β.

    Args:
        task: World and utility.
        replicas: Agents for each combination of prices, budgets and rates, of seeds `seed`,
            `seed` + 1, ….
        grid: Whether lists are combined, and not walked through side by side.
        compile: Whether updates are made in blocks of compiled code, see `Agent`.
        beta_perception: β₁, inverse price of I(Ω;X), per nat: one or several; None is 1, or what
            leads to the budget.
        beta_action: β₂, inverse price of I(X;A), per nat, likewise.
        perception_rate: Learning rate of the perception channel, one or several; None is that of
            `perception_optimizer`.
        action_rate: The same for the action channel.
        perception_optimizer: As for `Agent`; one that treats each parameter by itself.
        action_optimizer: The same for the action channel.
        seed: The first seed. None takes a number from torch's default generator.
        perception_bits: The most bits that I(Ω;X) is to have, in place of `beta_perception`: one or
            several.
        action_bits: The same for I(X;A), in place of `beta_action`.
        agent: The other arguments of `Agent`.

    Attributes:
        settings: Seed, prices, budgets and rates of every member.
        updates: Updates made so far, of every member; part of every checkpoint.
        samples: World-states drawn so far, by every member; part of every checkpoint.
        terms: The terms of J as the last update saw them, (R,) each.

    Raises:
        TypeError: As `Agent`.
        ValueError: As `Agent`; and if lists do not fit together, or an optimizer would let members
            disturb each other.
    """

    def __init__(
        self,
        task: Task,
        replicas: int = 16,
        grid: bool = False,
        compile: Compile = "auto",
        beta_perception: Values | None = None,
        beta_action: Values | None = None,
        perception_rate: Values | None = None,
        action_rate: Values | None = None,
        perception_optimizer: OptimizerFactory | None = None,
        action_optimizer: OptimizerFactory | None = None,
        seed: int | None = None,
        perception_bits: Values | None = None,
        action_bits: Values | None = None,
        **agent: Any,
    ) -> None:
        super().__init__()
        self.compiled = check_compile(compile)
        self.task = task
        self.seed = int(torch.randint(2**31, ())) if seed is None else check_seed(seed)
        replicas, grid = check_count(replicas, "replicas"), check_flag(grid, "grid")
        looks = agent.get("beta_direct") is not None
        varied = {
            "beta_perception": beta_perception,
            "beta_action": beta_action,
            "perception_rate": perception_rate,
            "action_rate": action_rate,
            "perception_bits": perception_bits,
            "action_bits": action_bits,
        }
        self._expand = partial(expand_settings, replicas, varied, grid, looks, cheap(task))
        optimizers = {
            "perception_optimizer": perception_optimizer,
            "action_optimizer": action_optimizer,
        }
        given = Parts.of(agent | optimizers)
        found = choose(task, given, looks)
        self._given, self._parts, self.cooling = given, found, found.cooling
        self.beta_direct = agent.get("beta_direct")
        self._set_settings()
        self._factories = (found.perception_optimizer, found.action_optimizer)
        agent.update({n: p for n, p in vars(found).items() if n not in optimizers})
        agent["update_rule"] = copy.deepcopy(found.update_rule)
        self._agent_arguments = agent

        self._gather([self._agent(setting) for setting in self._settings])

    def _gather(self, members: list[Agent]) -> None:
        """Makes one batch of all members."""
        first = members[0]
        self.percept_space = first.percept_space
        self._sees_worlds = first.update_rule.sees_worlds(first.chain)
        self._held_back = first.evaluation_worlds()
        self._stack = Stack(members)
        parts = self._stack.modules
        self.perception, self.action = parts.perception, parts.action
        self.marginals, self.update_rule = parts.marginals, parts.update_rule
        self.budgets = parts.budgets
        self._stacked_loss = StackedLoss(self._stack, self._sees_worlds)

        self.scheduler_factories = first.scheduler_factories
        rates = (
            [getattr(s, f"{c}_rate") for s in self._settings] for c in ("perception", "action")
        )
        made = map(stacked_factory, self._factories, rates, NAMES)
        (perception, self._perception_scale), (action, self._action_scale) = made
        self.optimizer_factories = (perception, action)
        self.recipe = self._describe(first)

    def _describe(self, first: Agent) -> dict[str, Recipe]:
        """The recipe: that of the first member, but for what members differ in."""
        given = self.init_arguments().items()
        own = {k: v for k, v in given if v is not None and k not in self._agent_arguments}
        own |= zip(NAMES, self._factories, strict=True)
        described: dict[str, Recipe] = to_recipe(own | {"seed": self.seed})
        return first.recipe | described

    @property
    def chosen(self) -> str:
        """A line that says what was chosen; empty if nothing was."""
        return chosen_line(self._given, self._parts)

    def _settle(self, run: int) -> None:
        self.cooling = self.cooling and self.cooling.settled(run)
        rule = self._agent_arguments["update_rule"]
        rule.settle(run)
        self.update_rule.settle(run)
        self._agent_arguments["cooling"] = self.cooling
        self._wait_for_cooling()
        self._parts = replace(self._parts, cooling=self.cooling, update_rule=rule)
        self._set_settings()
        self.recipe = self._describe(self._agent(self._settings[0]))

    def _set_settings(self) -> None:
        self._settings = self._expand(self.seed)
        self._seeds = tuple(setting.seed for setting in self._settings)
        self._prices = Prices(self._settings, self.cooling, self.beta_direct)

    def _agent(self, setting: Setting) -> Agent:
        """A member as it starts."""
        perception, action = self._factories
        betas, budgets = setting.given_prices, setting.budgets
        return Agent(
            self.task,
            beta_perception=betas[0],
            beta_action=betas[1],
            perception_bits=budgets[0],
            action_bits=budgets[1],
            perception_optimizer=with_rate(perception, setting.perception_rate),
            action_optimizer=with_rate(action, setting.action_rate),
            seed=setting.seed,
            **self._agent_arguments,
        )

    def _uses_worlds(self) -> bool:
        return self._sees_worlds

    @property
    def world_seeds(self) -> list[int] | None:
        """The seeds of the members' worlds; None where the rule looks at no worlds."""
        return [*self._seeds] if self._sees_worlds else None

    def on_fit_start(self) -> None:
        """Makes sure that the worlds are those of the task, and that no loss is to be scaled.

        Raises:
            ValueError: If the data module draws from another task, or the precision scales losses.
        """
        if getattr(self.trainer.precision_plugin, "scaler", None) is not None:
            raise ValueError(
                "a population's gradients are not scaled, got precision 16-mixed; use "
                "precision bf16-mixed or 32-true"
            )
        super().on_fit_start()

    def find_gradient(self, world: World) -> None:
        """Leaves the gradient of each member's loss in its own slice of the parameters."""
        prices = self._prices.at(self.updates, self.device, torch.get_default_dtype())
        loss, terms = self._stacked_loss(world, prices, self._seeds, self.updates, UPDATE)
        self.terms = Objective(**terms)
        self.back_propagate(loss)

    def all_agents(self, optimizers: Sequence[Optimizer], clip: Clip | None) -> Many:
        """The members, for blocks."""
        equal = torch.ones(len(self))
        scales = (equal if s is None else s for s in (self._perception_scale, self._action_scale))
        return Many(
            self._stack.modules,
            self._stack.state,
            optimizers,
            stacked=True,
            scales=torch.stack([*scales]).to(self.device, torch.get_default_dtype()),
            keys=stream_keys(self._seeds, UPDATE, self.device),
            own_worlds=self._sees_worlds,
            clip=clip,
        )

    def _own_terms(self, terms: dict[str, Tensor]) -> Objective[Tensor]:
        return Objective(**terms)

    def _prices_along(self, updates: range) -> Tensor:
        return self._prices.along(updates)

    def _step(self, optimizers: list[LightningOptimizer]) -> None:
        varied = [
            (list(channel.parameters()), scale)
            for channel, scale in (
                (self.perception, self._perception_scale),
                (self.action, self._action_scale),
            )
            if scale is not None
        ]
        before = [[stack.detach().clone() for stack in stacks] for stacks, _ in varied]
        super()._step(optimizers)
        for (stacks, scale), old in zip(varied, before, strict=True):
            scale_steps(stacks, old, scale)

    def _count(self, world: World) -> int:
        return world.state.shape[1 if self._sees_worlds else 0]

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Adds counters, the recipe, and which member is best, for `Agent.load_from_checkpoint`."""
        super().on_save_checkpoint(checkpoint)
        checkpoint[checkpoints.KEY] |= {
            "best": self.best_index(),
            "best_recipe": self.best_agent().recipe,
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Takes over counters and seeds."""
        super().on_load_checkpoint(checkpoint)
        self._set_settings()

    @classmethod
    def _unpack(cls, checkpoint: dict[str, Any]) -> dict[str, Any]:
        if "best" not in checkpoint[checkpoints.KEY]:
            raise ValueError(
                "the checkpoint holds one agent and no population; use Agent.load_from_checkpoint"
            )
        return checkpoint
