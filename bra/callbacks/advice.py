"""What to do next when a run ends short of the optimum."""

from bra.agent import Agent
from bra.checks.words import amount
from bra.tasks import FiniteTask, knows_signals
from bra.tasks.signals import over_signals
from bra.update_rules import Projection

SHORT = 0.01
"""Share of the range of utilities that a run may miss without a word."""


def advice(agent: Agent, gap: float | None, replicas: int = 1) -> str:
    """One line if J misses the optimum by more than 1 % of the range of utilities, else none.

    Args:
        agent: The best of the run.
        gap: By how much it misses the optimum; None if that is not known.
        replicas: Agents that were trained.
    """
    if gap is None or not isinstance(agent.task, FiniteTask):
        return ""
    spread = agent.task.utility_range
    if gap <= SHORT * spread:
        return ""
    missed = f"J misses the optimum by {gap / spread:.1%} of the range of utilities"
    return f"{missed}: {_step(agent, replicas)}"


def _step(agent: Agent, replicas: int) -> str:
    """What is most likely to help."""
    rule, cooling = agent.update_rule, agent.cooling
    if cooling and agent.updates < cooling.updates:
        ends = amount(int(cooling.updates), "update")
        return f"prices reach their own after {ends}; train longer"
    if not isinstance(rule, Projection):
        return "leave update_rule out, which then is chosen for the task"
    if not rule.rivals and not rule.critic and knows_signals(over_signals(agent.task)):
        return "give update_rule Projection its rivals, or leave it out"
    if rule.rivals and agent.updates < rule.rivals.settled:
        return f"rivals settle after {amount(rule.rivals.settled, 'update')}; train longer"
    if replicas == 1:
        return "train several seeds, --model.replicas 16, and longer, --trainer.max_epochs"
    return "train longer, --trainer.max_epochs, or give perception more hidden units"
