"""The agent: perception and action in series, trained on J."""

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Self

import torch
from gymnasium.spaces import Box, Discrete, Tuple
from torch import Tensor
from torch.optim import Optimizer

from bra.agent.defaults import ChannelFactory, Parts, choose, chosen_line
from bra.agent.making import check_looks, make_channel
from bra.agent.member import Member
from bra.agent.optimizers import OptimizerFactory, SchedulerFactory
from bra.agent.trained import UPDATE, Compile, check_compile
from bra.blocks import Many
from bra.blocks.recording import Clip
from bra.budgets import Budgets
from bra.checkpoints import files as checkpoints
from bra.checkpoints.recipes import to_recipe
from bra.checks.prices import check_beta, refuse_free
from bra.checks.settings import check_count, check_kind, check_representable, check_seed
from bra.cooling import Cooling
from bra.marginals import Marginals, default_marginals
from bra.objective import Objective
from bra.randomness.draws import Uniform
from bra.randomness.generators import counted
from bra.randomness.keys import stream_keys, update_key
from bra.tasks import FiniteTask, Task, World
from bra.update_rules import UpdateRule


class Agent(Member):
    """Maximises J = E[U] − I(Ω;X)/β₁ − I(X;A)/β₂ over a perception and an action channel.

    What is not given is chosen from the task, see `bra.agent.defaults.choose`; the fit begins with
    a line that says what.

    One training step is one update of both channels. `trainer.global_step`, and with it
    `max_steps`, checkpoint intervals and logged steps, counts updates.

    Args:
        task: World and utility.
        perception: Makes p(x|ξ) from (observation space, percept space): a `Channel` class, or a
            `functools.partial` of one.
        action: Makes p(a|x) from (percept space, action space).
        percepts: |X|, or the percept space.
        beta_perception: β₁, inverse price of I(Ω;X), per nat; None is 1, or what leads to the
            budget.
        beta_action: β₂, inverse price of I(X;A), per nat; with `beta_direct` it may be inf, where
            what a percept tells of the action is free.
        update_rule: How encounters move the channels.
        perception_optimizer: Makes the optimizer of the perception channel's parameters.
        action_optimizer: Makes the optimizer of the action channel's parameters.
        perception_scheduler: Makes a learning-rate schedule, stepped once per update.
        action_scheduler: The same for the action channel.
        marginals: The way to p(x) and p(a); None is exact where the task's states are known,
            running averages for other tasks with discrete percepts, else the batch's.
        cooling: How the prices that updates see approach β₁ and β₂; None keeps them there if
            a rule is given, and factors of 1 do in any case.
        seed: Of the initial channels and of all that updates draw. None takes a number from
            torch's default generator.
        beta_direct: β₃, inverse price of I(ξ;A|X), per nat: the action channel is then
            p(a|x,ξ), made from the `Tuple` of percepts and observations, and J is less by
            I(ξ;A|X)/β₃. None where actions see the world through the percept alone.
        compile: Whether updates are made in blocks of compiled code, see `Trained`; "auto" where
            the run is long enough to win back the compilation.
        perception_bits: The most bits that I(Ω;X) is to have, in place of `beta_perception`: the
            price then follows the budget, see `bra.budgets.Budgets`, once `cooling` is over.
        action_bits: The same for I(X;A), in place of `beta_action`.

    Attributes:
        updates: Updates made so far; part of every checkpoint.
        samples: World-states drawn so far; part of every checkpoint.
        terms: The terms of J as the last update saw them.
        held_back: What `evaluate` looks at, once it has; no update sees it.

    Raises:
        TypeError: If a factory makes something other than a channel, or a channel's forward
            returns no distribution.
        ValueError: If a price is not positive and finite, a channel has a price and a budget,
            `percepts` less than 1, spaces do not
            fit, or rule or marginals cannot work with these channels.
    """

    def __init__(
        self,
        task: Task,
        perception: ChannelFactory | None = None,
        action: ChannelFactory | None = None,
        percepts: int | Discrete | Box | None = None,
        beta_perception: float | None = None,
        beta_action: float | None = None,
        update_rule: UpdateRule | None = None,
        perception_optimizer: OptimizerFactory | None = None,
        action_optimizer: OptimizerFactory | None = None,
        perception_scheduler: SchedulerFactory | None = None,
        action_scheduler: SchedulerFactory | None = None,
        marginals: Marginals | None = None,
        cooling: Cooling | None = None,
        seed: int | None = None,
        beta_direct: float | None = None,
        compile: Compile = "auto",
        perception_bits: float | None = None,
        action_bits: float | None = None,
    ) -> None:
        super().__init__()
        self.compiled = check_compile(compile)
        optimizers = (perception_optimizer, action_optimizer)
        given = Parts(percepts, update_rule, perception, action, *optimizers, cooling)
        looks = beta_direct is not None
        parts = choose(task, given, looks)
        self.task = task
        self._set_prices(beta_perception, beta_action, beta_direct, perception_bits, action_bits)
        self.percept_space = (
            parts.percepts
            if isinstance(parts.percepts, Discrete | Box)
            else Discrete(check_count(parts.percepts, "percepts"))
        )
        self.seed = int(torch.randint(2**31, ())) if seed is None else check_seed(seed)
        self.cooling = parts.cooling
        self._wait_for_cooling()
        self._check_representable()
        self.held_back: World | None = None

        if looks:
            check_looks(self.percept_space, parts.update_rule)
        signals = task.observation_space
        condition = Tuple((self.percept_space, signals)) if looks else self.percept_space
        made = partial(make_channel, seed=self.seed)
        self.perception = made("perception", parts.perception, signals, self.percept_space)
        self.action = made("action", parts.action, condition, task.action_space)
        # Copies, since both may have a state that belongs to this agent alone.
        self.marginals = self._checked(copy.deepcopy(marginals), looks)
        self.update_rule = copy.deepcopy(parts.update_rule)
        with counted(self.seed, 0, "update rule", torch.device("cpu")):
            self.update_rule.check(self.chain)
        self.optimizer_factories = (parts.perception_optimizer, parts.action_optimizer)
        self.scheduler_factories = (perception_scheduler, action_scheduler)
        self.configure_optimizers()  # so that wrong settings are refused here and not in fit()
        self._given, self._parts = given, parts
        self.recipe = to_recipe(self.init_arguments())

    def _checked(self, marginals: Marginals | None, looks: bool) -> Marginals:
        """Marginals that fit, those that are given or else chosen."""
        found = marginals
        if found is None:
            found = default_marginals(self.task, self.percept_space, looks)
        check_kind(found, Marginals, "marginals")
        found.check(self.task, self.percept_space)
        if looks:
            found.check_looks(self.task, self.percept_space)
        return found

    def _set_prices(
        self,
        beta_perception: float | None,
        beta_action: float | None,
        beta_direct: float | None,
        perception_bits: float | None,
        action_bits: float | None,
    ) -> None:
        """Takes prices that are some, and budgets in place of prices."""
        betas, bits = (beta_perception, beta_action), (perception_bits, action_bits)
        self.budgets = Budgets.of(self.task, betas, bits)
        start = [1.0 if beta is None else beta for beta in betas]
        if self.budgets:
            limits = zip(start, self.budgets.limits, strict=True)
            start = [beta if limit is None else self.budgets.start for beta, limit in limits]
        if isinstance(beta_direct, float) and all(isinstance(beta, float) for beta in start):
            refuse_free(start[0], start[1], beta_direct)
        self._start = (
            check_beta(start[0], "beta_perception"),
            check_beta(start[1], "beta_action", infinite=beta_direct is not None),
        )
        self.beta_direct = None if beta_direct is None else check_beta(beta_direct, "beta_direct")

    def _check_representable(self) -> None:
        """Asks for utilities, and prices from the first update on, that updates can count in."""
        factor, action_factor = self.cooling.factors(self.seed) if self.cooling else (1.0, 1.0)
        for name, cooled in (
            ("beta_perception", factor),
            ("beta_action", action_factor),
            ("beta_direct", action_factor),
        ):
            if (beta := getattr(self, name)) and beta < math.inf:
                check_representable(beta, name)
                check_representable(beta * cooled, f"{name} times the factor of cooling")
        if isinstance(self.task, FiniteTask) and (stakes := self.task.stakes):
            check_representable(stakes, "what utilities of a state differ by")

    @property
    def chosen(self) -> str:
        """A line that says what was chosen; empty if nothing was."""
        return chosen_line(self._given, self._parts)

    def _settle(self, run: int) -> None:
        self.cooling = self.cooling and self.cooling.settled(run)
        self._wait_for_cooling()
        self.update_rule.settle(run)
        self._parts = replace(self._parts, cooling=self.cooling, update_rule=self.update_rule)
        self.recipe = to_recipe(self.init_arguments())

    def init_arguments(self) -> dict[str, Any]:
        """As given, and with what was left to the agent; prices that follow a budget are none."""
        limits = self.budgets.limits if self.budgets else (None, None)
        prices = zip(("beta_perception", "beta_action"), limits, strict=True)
        paid = {name: getattr(self, name) for name, limit in prices if limit is None}
        filled = (
            vars(self._parts)
            | paid
            | {
                "percepts": self.percept_space,
                "update_rule": self.update_rule,
                "marginals": self.marginals,
                "seed": self.seed,
            }
        )
        given = super().init_arguments()
        return given | {name: value for name, value in filled.items() if name in given}

    def _uses_worlds(self) -> bool:
        return self.update_rule.sees_worlds(self.chain)

    def find_gradient(self, world: World) -> None:
        """Back-propagates the rule's loss."""
        self.back_propagate(self.update_loss(world))

    def update_loss(self, world: World) -> Tensor:
        """The rule's loss for one batch of worlds; leaves the terms of J in `terms`."""
        uniform = Uniform(update_key(self.seed, UPDATE, self.updates))
        with counted(self.seed, self.updates, UPDATE, self.device):
            loss, self.terms = self.update_rule.loss(self.coming_chain(uniform), world)
        return loss

    def all_agents(self, optimizers: Sequence[Optimizer], clip: Clip | None) -> Many:
        """The agent, for blocks."""
        modules = self.modules_of_chain()
        tensors = (*modules.named_parameters(), *modules.named_buffers())
        return Many(
            modules,
            {name: tensor.detach().unsqueeze(0) for name, tensor in tensors},
            optimizers,
            stacked=False,
            scales=torch.ones(2, 1, dtype=torch.get_default_dtype(), device=self.device),
            keys=stream_keys((self.seed,), UPDATE, self.device),
            own_worlds=False,
            clip=clip,
        )

    def _own_terms(self, terms: dict[str, Tensor]) -> Objective[Tensor]:
        return Objective(**{name: term[0] for name, term in terms.items()})

    def _prices_along(self, updates: range) -> Tensor:
        direct = [] if self.beta_direct is None else [self.beta_direct]
        own = torch.tensor([*self._start, *direct], dtype=torch.double)
        if self.cooling is None:
            return own.reshape(1, -1, 1).expand(len(updates), -1, -1)
        return self.cooling.along(own.unsqueeze(-1), updates, (self.seed,))

    def best_agent(self) -> Self:
        """Itself."""
        return self

    @classmethod
    def _unpack(cls, checkpoint: dict[str, Any]) -> dict[str, Any]:
        """Of a population's checkpoint, the agent that did best."""
        return checkpoints.best_member(checkpoint)
