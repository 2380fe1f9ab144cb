"""The certified optimum beside the curves."""

import lightning.pytorch as pl
from gymnasium.spaces import Discrete
from lightning.pytorch.loggers import TensorBoardLogger

from bra.agent import Agent
from bra.blahut_arimoto import Serial, rate_distortion, serial
from bra.callbacks.schedule import Monitor, agent_of, log_metrics
from bra.checks import check_count
from bra.tasks import FiniteTask

LAYOUT = {
    "bra": {
        "J, its optimum and its bound": [
            "Multiline",
            ["objective/J", "objective/blahut_arimoto", "objective/upper_bound"],
        ],
        "information in bits": [
            "Multiline",
            [
                "information/perception_bits",
                "information/action_bits",
                "information/end_to_end_bits",
            ],
        ],
    }
}


class BaselineMonitor(Monitor):
    """Solves for the optimum when training starts, and logs it as lines over the whole run.

    Logged keys: `objective/blahut_arimoto`, J of the best serial Blahut-Arimoto solution;
    `objective/upper_bound`, which no agent can exceed; and `objective/gap`, by which the agent
    falls short of the optimum, and which the progress bar shows. In TensorBoard a custom-scalars
    page lays J, optimum and bound over each other.

    Percepts that are not discrete have a bound and no optimum; tasks without a table of utilities
    have neither.

    Args:
        restarts: Starts of the serial problem, which has local optima.
        every_n_updates: Updates between two points of the lines.

    Attributes:
        optimum: The best serial solution, once training has started.
        upper_bound: The certified bound on J, once training has started.
    """

    def __init__(self, restarts: int = 32, every_n_updates: int = 100) -> None:
        super().__init__(every_n_updates)
        self.restarts = check_count(restarts, "restarts")
        self.optimum: Serial | None = None
        self.upper_bound: float | None = None

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Solves."""
        agent = agent_of(pl_module)
        self.optimum = solve_optimum(agent, self.restarts)
        self.upper_bound = solve_upper_bound(agent, self.optimum)
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger) and self.upper_bound is not None:
                logger.experiment.add_custom_scalars(LAYOUT)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the lines on, and the gap in the bar."""
        lines = {}
        if self.upper_bound is not None:
            lines["objective/upper_bound"] = self.upper_bound
        if self.optimum is not None:
            optimum = float(self.optimum.objective)
            gap = optimum - agent.evaluate().objective
            lines |= {"objective/blahut_arimoto": optimum, "objective/gap": gap}
            trainer.progress_bar_metrics["gap"] = gap
        log_metrics(trainer, agent, lines)


def solve_optimum(agent: Agent, restarts: int = 32) -> Serial | None:
    """The best serial solution of an agent's problem; None without finite states and percepts."""
    if not (isinstance(agent.task, FiniteTask) and isinstance(agent.percept_space, Discrete)):
        return None
    return serial(
        agent.task.utilities,
        agent.task.prior,
        int(agent.percept_space.n),
        agent.beta_perception,
        agent.beta_action,
        restarts=restarts,
        seed=agent.seed,
    )


def solve_upper_bound(agent: Agent, optimum: Serial | None) -> float | None:
    """The bound on J of an agent's problem, whatever its percepts; None without a table.

    By data processing I(Ω;A) ≤ min(I(Ω;X), I(X;A)), so that one channel at
    1/β = 1/β₁ + 1/β₂ does at least as well as the two.
    """
    if optimum is not None:
        return float(optimum.upper_bound)
    if not isinstance(agent.task, FiniteTask):
        return None
    beta = 1 / (1 / agent.beta_perception + 1 / agent.beta_action)
    return float(rate_distortion(agent.task.utilities, agent.task.prior, beta).upper_bound)
