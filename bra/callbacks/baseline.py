"""The certified optimum beside the curves."""

import lightning.pytorch as pl
from lightning.pytorch.loggers import TensorBoardLogger

from bra.agent import Agent, Learner
from bra.callbacks.schedule import Monitor, learner_of, log_metrics
from bra.checks import check_count
from bra.evaluation.references import Prices, Reference, solve_references
from bra.objective import TERMS

LAYOUT = {
    "bra": {
        "J, its optimum and its bound": [
            "Multiline",
            [
                "objective/J",
                "objective/blahut_arimoto",
                "objective/without_sensor_noise",
                "objective/upper_bound",
            ],
        ],
        "information in bits": [
            "Multiline",
            [term.tag for term in TERMS.values() if term.in_bits],
        ],
    }
}


class BaselineMonitor(Monitor):
    """Solves for the optimum when training starts, and logs it as lines over the whole run.

    Logged keys: `objective/blahut_arimoto`, J of the best serial Blahut-Arimoto solution that the
    sensor allows; `objective/without_sensor_noise`, what it would be if a noisy sensor had no
    noise; `objective/upper_bound`, which no agent can exceed; and `objective/gap`, by which the
    agent falls short of the optimum, and which the progress bar shows. In TensorBoard a
    custom-scalars page lays J, optimum and bound over each other.

    Percepts that are not discrete, and sensors of unknown noise, have a bound and no optimum; tasks
    without a table of utilities have an optimum on grids, and no bound, if they say how to put them
    on one, see `bra.Task.grid`, else neither. The prices of a population's agents are solved for
    together; the lines are those of the prices of its best agent.

    Args:
        restarts: Starts of the serial problem, which has local optima.
        every_n_updates: Updates between two points of the lines.
        certify: Seconds to spend on lowering the bound of a single pair of prices when training
            starts, as in `bra.blahut_arimoto.serial`.

    Attributes:
        references: Optimum and bound for each pair of prices, once training has started.
    """

    def __init__(
        self, restarts: int = 32, every_n_updates: int = 100, certify: float | None = None
    ) -> None:
        super().__init__(every_n_updates)
        self.certify = certify
        self.restarts = check_count(restarts, "restarts")
        self.references: dict[Prices, Reference] = {}

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Solves."""
        learner = learner_of(pl_module)
        self.references = solve_all_references(learner, self.restarts, self.certify)
        reference = self.reference(learner.best_agent())
        for logger in trainer.loggers:
            known = reference.optimum is not None or reference.upper_bound is not None
            if isinstance(logger, TensorBoardLogger) and known:
                logger.experiment.add_custom_scalars(LAYOUT)

    def reference(self, agent: Agent) -> Reference:
        """What there is to compare an agent with, at its own prices."""
        return self.references[agent.beta_perception, agent.beta_action]

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the lines on, and the gap in the bar."""
        reference = self.reference(agent)
        lines = {
            "objective/blahut_arimoto": reference.objective,
            "objective/without_sensor_noise": reference.objective_without_noise,
            "objective/upper_bound": reference.bound,
        }
        if reference.objective is not None:
            gap = reference.objective - agent.evaluate().objective
            lines["objective/gap"] = trainer.progress_bar_metrics["gap"] = gap
        known = {name: value for name, value in lines.items() if value is not None}
        log_metrics(trainer, agent, known)


def baseline_of(trainer: pl.Trainer) -> BaselineMonitor | None:
    """The run's monitor of the optimum, if it has one."""
    callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
    return next((c for c in callbacks if isinstance(c, BaselineMonitor)), None)


def solve_reference(agent: Agent, restarts: int = 32, certify: float | None = None) -> Reference:
    """What there is to compare an agent with."""
    (found,) = solve_all_references(agent, restarts, certify).values()
    return found


def solve_all_references(
    learner: Learner, restarts: int = 32, certify: float | None = None
) -> dict[Prices, Reference]:
    """What there is to compare agents with at each of their prices."""
    agent = learner.best_agent()
    prices = list(dict.fromkeys(setting.prices for setting in learner.settings))
    task, percepts = agent.task, agent.percept_space
    return solve_references(
        task, percepts, prices, learner.seed, restarts, certify, agent.beta_direct
    )
