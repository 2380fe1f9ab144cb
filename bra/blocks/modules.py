"""What of an agent has a state as one module, and its loss as a function of tensors."""

from collections.abc import Callable
from typing import Any

from torch import Tensor, nn
from torch.func import functional_call

from bra.budgets import Budgets
from bra.chain import Chain
from bra.channels import Channel
from bra.marginals import Marginals
from bra.randomness.draws import Uniform
from bra.randomness.keys import split
from bra.tasks import Task, World
from bra.update_rules import UpdateRule

Terms = dict[str, Tensor]


class Modules(nn.Module):
    """Task, channels, marginals, rule and, where there are some, budgets of an agent."""

    def __init__(
        self,
        task: Task,
        perception: Channel,
        action: Channel,
        marginals: Marginals,
        update_rule: UpdateRule,
        budgets: Budgets | None = None,
    ) -> None:
        super().__init__()
        self.task = task
        self.perception = perception
        self.action = action
        self.marginals = marginals
        self.update_rule = update_rule
        self.budgets = budgets

    def forward(self, function: Callable[..., Any], *args: Any) -> Any:
        """Returns `function(self, *args)`, with whatever state this module has for now."""
        return function(self, *args)

    def call(self, state: dict[str, Tensor], function: Callable[..., Any], *args: Any) -> Any:
        """`function(self, *args)` in a state, by name."""
        return functional_call(self, state, (function, *args))

    def loss(
        self, prices: tuple[Tensor, ...], world: World, update: int | Tensor, uniform: Uniform
    ) -> tuple[Tensor, Terms]:
        """The rule's loss, and the terms of J that it knows.

        Args:
            prices: β₁, β₂ and, where actions look at the signal again, β₃, before they follow
                budgets.
            world: The worlds of the update.
            update: Its number; in compiled code a tensor of shape ().
            uniform: Its random numbers.
        """
        led = self.budgets.lead(prices) if self.budgets else prices
        chain = Chain.of(self, *led, update=update, uniform=uniform)  # type: ignore[arg-type]  # a tensor serves where it is not asked for control flow
        loss, terms = self.update_rule.loss(chain, world)
        return loss, terms.known()

    def keyed_loss(
        self, prices: tuple[Tensor, ...], world: World, update: Tensor, key: Tensor
    ) -> tuple[Tensor, Terms]:
        """`loss` with the key of the stream that all its updates draw from."""
        return self.loss(prices, world, update, Uniform(split(key, update)))

    def follow(self, terms: Terms, update: Tensor) -> None:
        """Moves prices that follow budgets, after an update that has seen these terms."""
        if self.budgets:
            rates = terms["perception_information"], terms["action_information"]
            self.budgets.follow(rates, update)
