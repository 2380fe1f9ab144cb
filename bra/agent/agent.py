"""The agent: perception and action in series, trained on J."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Self

import torch
from gymnasium.spaces import Box, Discrete, Space, Tuple
from torch import Tensor
from torch.optim import Optimizer

from bra.agent.defaults import ChannelFactory, Parts, choose, chosen_line
from bra.agent.learner import Learner
from bra.agent.optimizers import OptimizerFactory, SchedulerFactory, check_factory
from bra.agent.settings import Setting
from bra.agent.trained import UPDATE, Compile, check_compile
from bra.arrays import Array
from bra.blocks import Many
from bra.blocks.recording import Clip
from bra.budgets import Budgets
from bra.chain import Chain
from bra.channels import Channel
from bra.channels.base import check_channel
from bra.checkpoints import files as checkpoints
from bra.checkpoints.recipes import to_recipe
from bra.checks import (
    check_beta,
    check_count,
    check_kind,
    check_representable,
    check_seed,
    refuse_free,
)
from bra.cooling import Cooling
from bra.evaluation import Evaluation, evaluate, evaluation_worlds
from bra.marginals import Marginals, default_marginals
from bra.memory import TooLarge, missing_memory
from bra.objective import Objective
from bra.randomness.draws import Uniform
from bra.randomness.generators import counted
from bra.randomness.keys import stream_keys, update_key
from bra.tasks import FiniteTask, Rollout, Task, World, knows_signals
from bra.tasks.observations import as_signals
from bra.update_rules import UpdateRule


class Agent(Learner):
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
            self._check_looks(parts.update_rule)
        self.perception = self._make_channel(
            "perception", parts.perception, task.observation_space, self.percept_space
        )
        condition = Tuple((self.percept_space, task.observation_space))
        self.action = self._make_channel(
            "action", parts.action, condition if looks else self.percept_space, task.action_space
        )
        # Copies, since both may have a state that belongs to this agent alone.
        self.marginals = copy.deepcopy(marginals) or default_marginals(
            task, self.percept_space, looks
        )
        check_kind(self.marginals, Marginals, "marginals")
        self.marginals.check(task, self.percept_space)
        if looks:
            self.marginals.check_looks(task, self.percept_space)
        self.update_rule = copy.deepcopy(parts.update_rule)
        with counted(self.seed, 0, "update rule", torch.device("cpu")):
            self.update_rule.check(self.chain)
        self.optimizer_factories = (parts.perception_optimizer, parts.action_optimizer)
        self.scheduler_factories = (perception_scheduler, action_scheduler)
        self.configure_optimizers()  # so that wrong settings are refused here and not in fit()
        self._given, self._parts = given, parts
        self.recipe = to_recipe(self.init_arguments())

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

    def _check_looks(self, rule: UpdateRule) -> None:
        if not isinstance(self.percept_space, Discrete):
            raise ValueError(
                "beta_direct needs Discrete percepts, each of which chooses a specialist, got "
                f"{self.percept_space}; give a number of percepts, or leave beta_direct out"
            )
        if not rule.looks:
            raise ValueError(
                f"beta_direct: {type(rule).__name__} does not train actions that look at the "
                "signal again; use Projection, ExactGradient or ScoreFunction"
            )

    def _make_channel(
        self, name: str, factory: ChannelFactory, condition: Space[Any], outcome: Space[Any]
    ) -> Channel:
        check_factory(factory, name, Channel)
        with counted(self.seed, 0, name, torch.device("cpu")):
            try:
                channel = factory(condition, outcome)
                check_channel(channel)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{name}: {error}") from error
            except (RuntimeError, MemoryError) as error:
                if not (line := missing_memory(error)):
                    raise
                raise TooLarge(f"{name}: no memory holds this channel: {line}") from error
        return channel

    @property
    def settings(self) -> tuple[Setting]:
        """Seed, prices and budgets."""
        bits = self.budgets.bits if self.budgets else (None, None)
        return (Setting(self.seed, *self._own_prices, None, None, *bits),)

    @property
    def beta_perception(self) -> float:
        """β₁, per nat; where it follows a budget, as it stands."""
        return self._own_prices[0]

    @property
    def beta_action(self) -> float:
        """β₂, likewise."""
        return self._own_prices[1]

    @property
    def _own_prices(self) -> tuple[float, float]:
        """β₁ and β₂ of the agent itself, cooling left aside."""
        factors = self.budgets.factors.tolist() if self.budgets else (1.0, 1.0)
        first, second = (beta * factor for beta, factor in zip(self._start, factors, strict=True))
        return first, second

    @property
    def chain(self) -> Chain:
        """Channels, marginals and prices."""
        return Chain.of(self, self.beta_perception, self.beta_action, self.beta_direct)

    @property
    def prices(self) -> tuple[float, float]:
        """β₁ and β₂ of the coming update."""
        if self.cooling is None:
            return self.beta_perception, self.beta_action
        scale, action_scale = self.cooling.scales(self.updates, self.seed)
        return scale * self.beta_perception, action_scale * self.beta_action

    @property
    def _direct_price(self) -> float | None:
        """β₃ of the coming update, which cools with β₂."""
        if self.beta_direct is None:
            return None
        scale = self.cooling.scales(self.updates, self.seed)[1] if self.cooling else 1.0
        return scale * self.beta_direct

    def coming_chain(self, uniform: Callable[..., Tensor] = torch.rand) -> Chain:
        """What the rule trains in the coming update, with its random numbers."""
        return Chain.of(self, *self.prices, self._direct_price).at(self.updates, uniform)

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

    @torch.no_grad()
    def act(self, observation: Array) -> tuple[Tensor, Tensor]:
        """Perceives and acts.

        Args:
            observation: ξ, (*batch,) for `Discrete` observations, (*batch, *shape) for a `Box`;
                a tensor, an array, or lists.

        Raises:
            ValueError: If these are no signals of the task.

        Returns:
            Percept x ~ p(x|ξ) and action a ~ p(a|x), (*batch, …).
        """
        observation = as_signals(self.task.observation_space, observation).to(self.device)
        percept = self.perception(observation).sample()
        return percept, self.chain.act(percept, observation).sample()

    def predict_step(self, world: World, batch_idx: int) -> Rollout:
        """Acts in every world of the batch."""
        with counted(self.seed, self.updates, f"predict {batch_idx}", self.device):
            percept, action = self.act(world.observation)
            return Rollout(*world, percept, action, self.task.utility(world.state, action))

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

    def best_agent(self) -> Self:
        """Itself."""
        return self

    def evaluate_members(self) -> Objective[Tensor]:
        """J and its terms, (1,) each, float64."""
        return self.evaluate().map(lambda value: torch.tensor([value], dtype=torch.double))

    def evaluation(self, world: World | None = None) -> Evaluation:
        """J, its terms, and the channels as tables; see `bra.evaluation.evaluate`.

        Args:
            world: Worlds to estimate from, where the task's states are not known or its sensor is
                noisy; None takes 1024 that no update sees, the same every time.
        """
        if world is None or knows_signals(self.task):
            return self._once(lambda: self._judge(self.evaluation_worlds()))
        return self._judge(world)

    def _judge(self, world: World) -> Evaluation:
        with self._evaluating(), counted(self.seed, self.updates, "evaluation", self.device):
            return evaluate(self.chain, World(*(part.to(self.device) for part in world)))

    def evaluation_worlds(self) -> World:
        """All states of a noiseless sensor, else worlds drawn once, which no update sees."""
        if self.held_back is None:
            self.held_back = evaluation_worlds(self.task, self.seed)
        return self.held_back

    @classmethod
    def _unpack(cls, checkpoint: dict[str, Any]) -> dict[str, Any]:
        """Of a population's checkpoint, the agent that did best."""
        return checkpoints.best_member(checkpoint)
