"""Many agents as they stand: the prices that they pay, what they come to, and each by itself."""

import math
from abc import abstractmethod
from dataclasses import asdict, replace
from numbers import Integral
from typing import Any, ClassVar

import torch
from gymnasium.spaces import Discrete, Space
from torch import Tensor

from bra.agent.agent import Agent
from bra.agent.learner import Learner
from bra.agent.optimizers import DIVERGED
from bra.agent.settings import Setting
from bra.channels import Channel
from bra.checks.words import shown
from bra.evaluation.evaluation import Evaluation
from bra.objective import Objective
from bra.population.evaluation import evaluate_stack, gather_objectives
from bra.population.prices import Betas, Prices
from bra.population.stack import Stack
from bra.tasks import FiniteStateTask, Rollout, World


class Members(Learner):
    """R agents to be read. Asked to act or to be evaluated, they answer with the best of them.

    `state_dict` has an agent's names, and R in front of every shape.
    """

    stacked: ClassVar[bool] = True
    percept_space: Space[Any]
    _settings: tuple[Setting, ...]
    _prices: Prices
    _stack: Stack
    _held_back: World

    @abstractmethod
    def _agent(self, setting: Setting) -> Agent:
        """A member as it starts."""

    def __len__(self) -> int:
        """R, the number of members."""
        return len(self._settings)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """Seed, prices, budgets and rates of every member."""
        if not self.budgets:
            return self._settings
        pairs = zip(self.beta_perception.tolist(), self.beta_action.tolist(), strict=True)
        return tuple(
            replace(setting, beta_perception=first, beta_action=second)
            for setting, (first, second) in zip(self._settings, pairs, strict=True)
        )

    @property
    def own_prices(self) -> Betas:
        """β₁, β₂ and, if there is one, β₃ that members are judged by, (R,) each, float64."""
        return self._led(self._prices.own(self.device))

    @property
    def beta_perception(self) -> Tensor:
        """β₁ of every member, (R,), float64."""
        return self.own_prices[0]

    @property
    def beta_action(self) -> Tensor:
        """β₂ of every member, (R,), float64."""
        return self.own_prices[1]

    @property
    def prices(self) -> Betas:
        """β₁, β₂ and, if there is one, β₃ of the members' coming update, (R,) each, float64."""
        return self._led(self._prices.at(self.updates, self.device))

    def _led(self, betas: Betas) -> Betas:
        """Prices as they follow budgets."""
        return self.budgets.lead(betas) if self.budgets else betas

    def member(self, index: int) -> Agent:
        """A member as it stands, as an agent of its own.

        Raises:
            IndexError: If there is none of this number, counted from 0.
        """
        whole = isinstance(index, Integral) and not isinstance(index, bool)
        if not (whole and 0 <= index < len(self)):
            raise IndexError(f"member must be between 0 and {len(self) - 1}, got {shown(index)}")
        agent = self._agent(self._settings[index])
        agent.load_state_dict({name: stack[index] for name, stack in self.state_dict().items()})
        agent.updates, agent.samples = self.updates, self.samples
        agent.terms = self.terms and self.terms.map(lambda values: values[index])
        agent.held_back = self._held_back
        return agent.to(self.device).train(self.training)

    def best_agent(self) -> Agent:
        """The best member, made once after each update: to be read, not to be trained."""
        return self._judgement()[1]

    def best_index(self) -> int:
        """Which member is best: the one of highest J, with budgets at what they are worth."""
        return self._best_of(self.evaluate_members())

    def _best_of(self, terms: Objective[Tensor]) -> int:
        """Compares E[U] − (I − B)/β, so that prices that follow a budget B do not matter."""
        worth = terms.objective
        for beta, limit in zip(self.own_prices, self._limits(), strict=False):
            worth = worth + (limit / beta).to(worth)
        return int(worth.argmax())

    def _limits(self) -> Tensor:
        """Budgets in nats, (2, R), 0 where there is none."""
        pairs = [[(bits or 0.0) * math.log(2) for bits in s.budgets] for s in self._settings]
        return torch.tensor(pairs, dtype=torch.double, device=self.device).T

    def evaluate_members(self) -> Objective[Tensor]:
        """J and its terms of every member, (R,) each, float64.

        All are judged by the same worlds; see `Agent.evaluate`.
        """
        return self._judgement()[0]

    def evaluation(self, world: World | None = None) -> Evaluation:
        """J of the best member, its terms, and its channels as tables; see `Agent.evaluation`."""
        return self.best_agent().evaluation(world)

    def act(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Lets the best member act; see `Agent.act`."""
        return self.best_agent().act(observation)

    def behaviour(self) -> Tensor:
        """p(a|ω) of the best member; see `Agent.behaviour`."""
        return self.best_agent().behaviour()

    def predict_step(self, world: World, batch_idx: int) -> Rollout:
        """Lets the best member act in every world of the batch."""
        return self.best_agent().predict_step(world, batch_idx)

    def _judgement(self) -> tuple[Objective[Tensor], Agent]:
        """The members' terms of J and the best of them."""

        def judge() -> tuple[Objective[Tensor], Agent]:
            terms = self._judge()
            return terms, self.member(self._best_of(terms))

        return self._once(judge)

    def _judge(self) -> Objective[Tensor]:
        spaces = (self.percept_space, self.task.action_space)
        enumerable = all(isinstance(space, Discrete) for space in spaces)
        if not (enumerable and isinstance(self.task, FiniteStateTask)):
            return gather_objectives([self.member(i).evaluate() for i in range(len(self))])
        world = World(*(part.to(self.device) for part in self._held_back))
        with self._evaluating():
            return evaluate_stack(self._stack, world, self.own_prices)

    def _whose(self, channel: Channel) -> str:
        sizes = [stack.detach().flatten(1).abs().amax(1) for stack in channel.parameters()]
        lost = (~(torch.stack(sizes).amax(0) < DIVERGED)).nonzero().flatten().tolist()
        setting = asdict(self.settings[lost[0]])
        found = ", ".join(f"{name} {value}" for name, value in setting.items() if value is not None)
        return f" for {len(lost)} of {len(self)} members, the first with {found}"
