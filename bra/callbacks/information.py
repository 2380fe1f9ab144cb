"""J and its terms as curves."""

import lightning.pytorch as pl

from bra.agent import Agent
from bra.callbacks.schedule import CurveMonitor, log_metrics
from bra.objective import Objective, bits, logged

PRICES = ("prices/beta_perception", "prices/beta_action", "prices/beta_direct")
FLOW = ("flow/perception_bits", "flow/with_action_bits", "flow/with_direct_bits")
"""One information on top of the other."""


class InformationMonitor(CurveMonitor):
    """Logs J, expected utility, the informations and their prices; J is in the progress bar.

    Exact for known states, a noiseless sensor and discrete percepts, estimated otherwise (see
    `bra.evaluation.evaluate` for the estimates and their bias). Logged keys:
    `objective/J`, `objective/expected_utility` (units of utility), `information/perception_bits`
    I(ξ;X), `information/action_bits` I(X;A), `information/end_to_end_bits` I(Ω;A), and, where
    the sensor is noisy, `information/state_bits` I(Ω;X); where states are not known
    `information/signal_action_bits` I(ξ;A) in place of I(Ω;A). Where J is estimated,
    `objective/J_standard_error`. `update/J`, `update/…`: the same
    terms as the last update saw them, in its batch and at its prices. `prices/beta_perception`,
    `prices/beta_action`: the β (per nat) of the coming update, which differ from the agent's own
    while it is cooling. Where actions look at the signal again, `prices/beta_direct`,
    `information/direct_bits` I(ξ;A|X), and, as curves one on top of the other,
    `flow/perception_bits`, `flow/with_action_bits` and `flow/with_direct_bits`. And what the update
    rule says of itself.

    Args:
        every_n_updates: Updates between two points of the curves; None is 100 (of more
            than 256 agents 200, …), and a hundredth of runs of more than 10 000 updates.
    """

    def __init__(self, every_n_updates: int | None = None) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Evaluates the agent and logs what comes out."""
        evaluation = agent.evaluation()
        objective, error = evaluation.objective, evaluation.standard_error
        spread = {"objective/J_standard_error": error.objective} if error else {}
        flow, rule = information_flow(objective), agent.update_rule.metrics()
        prices = _of_coming_update(agent)
        log_metrics(trainer, logged(objective) | spread | _of_update(agent) | prices | flow | rule)
        trainer.progress_bar_metrics["J"] = objective.objective


def information_flow(objective: Objective[float]) -> dict[str, float]:
    """I(Ω;X), I(X;A) and I(Ω;A|X), each on top of the last, in bits, where actions look again."""
    direct = objective.direct_information
    if direct is None:
        return {}
    height = objective.perception_information
    lines = [height, height := height + objective.action_information, height + direct]
    return {tag: bits(nats) for tag, nats in zip(FLOW, lines, strict=True)}


def _of_update(agent: Agent) -> dict[str, float]:
    """The terms of J as the last update saw them; none before the first."""
    return logged(agent.terms.item(), "update") if agent.terms else {}


def _of_coming_update(agent: Agent) -> dict[str, float]:
    """Its prices; the third where there is one."""
    betas = (*agent.prices, agent.coming_chain().beta_direct)
    return {tag: float(b) for tag, b in zip(PRICES, betas, strict=True) if b is not None}
