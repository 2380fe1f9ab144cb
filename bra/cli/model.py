"""What the command trains: one agent, or a population."""

from typing import Any

from bra.agent.agent import Agent
from bra.agent.defaults import Parts, choose
from bra.agent.learner import Learner
from bra.agent.optimizers import NAMES, OptimizerFactory
from bra.agent.trained import Compile
from bra.population.optimizers import with_rate
from bra.population.population import Population
from bra.tasks import Task


def make_model(
    task: Task,
    replicas: int = 1,
    grid: bool = False,
    compile: Compile = "auto",
    beta_perception: float | list[float] | None = None,
    beta_action: float | list[float] | None = None,
    perception_rate: float | list[float] | None = None,
    action_rate: float | list[float] | None = None,
    perception_optimizer: OptimizerFactory | None = None,
    action_optimizer: OptimizerFactory | None = None,
    seed: int | None = None,
    perception_bits: float | list[float] | None = None,
    action_bits: float | list[float] | None = None,
    **agent: Any,
) -> Learner:
    """An agent; with replicas, or lists of prices, budgets or rates, a population trained as one.

    Args:
        task: World and utility.
        replicas: Agents of seeds `seed`, `seed` + 1, … for each combination of prices, budgets and
            rates.
        grid: Whether all combinations of lists are taken, and not walked through side by side.
        compile: Whether updates are made in blocks of compiled code; auto where the run is long
            enough to win back the compilation.
        beta_perception: β₁, inverse price of I(Ω;X), per nat, 1 if there is no budget. Several make
            a population.
        beta_action: β₂, inverse price of I(X;A), per nat, likewise.
        perception_rate: Learning rate of the perception channel, in place of that of
            `perception_optimizer`. Several make a population.
        action_rate: Learning rate of the action channel, in place of that of `action_optimizer`.
            Several make a population.
        perception_optimizer: Makes the optimizer of the perception channel's parameters.
        action_optimizer: Makes the optimizer of the action channel's parameters.
        seed: Of the initial channels and of all that updates draw; a population's first.
        perception_bits: The most bits that I(Ω;X) is to have, in place of `beta_perception`: the
            price then follows the budget. Several make a population.
        action_bits: The same for I(X;A), in place of `beta_action`.
        agent: The other arguments of `Agent`.
    """
    prices, rates = (beta_perception, beta_action), (perception_rate, action_rate)
    budgets = (perception_bits, action_bits)
    if replicas == 1 and not any(isinstance(v, list) for v in (*prices, *rates, *budgets)):
        agent |= {
            "perception_optimizer": perception_optimizer,
            "action_optimizer": action_optimizer,
            "perception_bits": perception_bits,
            "action_bits": action_bits,
        }
        agent |= _with_rates(task, agent, *rates)
        agent |= {"beta_perception": beta_perception, "beta_action": beta_action}
        return Agent(task, seed=seed, compile=compile, **agent)
    varied = (*prices, *rates, perception_optimizer, action_optimizer, seed, *budgets)
    return Population(task, replicas, grid, compile, *varied, **agent)


def _with_rates(task: Task, agent: dict[str, Any], *rates: Any) -> dict[str, OptimizerFactory]:
    """The optimizers of one agent with the learning rates that are given, if any are."""
    if rates == (None, None):
        return {}
    found = choose(task, Parts.of(agent), agent.get("beta_direct") is not None)
    factories = (found.perception_optimizer, found.action_optimizer)
    made = (with_rate(factory, rate) for factory, rate in zip(factories, rates, strict=True))
    return dict(zip(NAMES, made, strict=True))
