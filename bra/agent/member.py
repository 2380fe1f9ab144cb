"""One agent as it stands: the prices that it pays, what it does, and what it comes to."""

from collections.abc import Callable
from typing import Any

import torch
from gymnasium.spaces import Space
from torch import Tensor

from bra.agent.learner import Learner
from bra.agent.settings import Setting
from bra.chain import Chain
from bra.checks.arrays import Array
from bra.evaluation import Evaluation, evaluate, evaluation_worlds
from bra.objective import Objective
from bra.randomness.generators import counted
from bra.tasks import FiniteTask, Rollout, World, knows_signals
from bra.tasks.observations import as_signals


class Member(Learner):
    """An agent to be read, as it stands."""

    percept_space: Space[Any]
    seed: int
    beta_direct: float | None
    held_back: World | None
    _start: tuple[float, float]

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
        prices = (*self.prices, self._direct_price)
        return Chain.of(self, *prices, update=self.updates, uniform=uniform)

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
