"""The certified optimum beside the curves."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import lightning.pytorch as pl
import torch
from gymnasium.spaces import Discrete
from lightning.pytorch.loggers import TensorBoardLogger

from bra.agent import Agent
from bra.blahut_arimoto import Serial, rate_distortion, serial
from bra.callbacks.schedule import Monitor, learner_of, log_metrics
from bra.checks import check_count
from bra.objective import TERMS
from bra.tasks import FiniteTask, Task

LAYOUT = {
    "bra": {
        "J, its optimum and its bound": [
            "Multiline",
            ["objective/J", "objective/blahut_arimoto", "objective/upper_bound"],
        ],
        "information in bits": [
            "Multiline",
            [term.tag for term in TERMS.values() if term.in_bits],
        ],
    }
}


Prices = tuple[float, float]


@dataclass(frozen=True)
class Reference:
    """What there is to compare an agent with.

    Attributes:
        optimum: The best serial solution; None without finite states and percepts.
        upper_bound: The certified bound on J; None without a table of utilities.
    """

    optimum: Serial | None
    upper_bound: float | None


class BaselineMonitor(Monitor):
    """Solves for the optimum when training starts, and logs it as lines over the whole run.

    Logged keys: `objective/blahut_arimoto`, J of the best serial Blahut-Arimoto solution;
    `objective/upper_bound`, which no agent can exceed; and `objective/gap`, by which the agent
    falls short of the optimum, and which the progress bar shows. In TensorBoard a custom-scalars
    page lays J, optimum and bound over each other.

    Percepts that are not discrete have a bound and no optimum; tasks without a table of utilities
    have neither. The prices of a population's agents are solved for together; the lines are those
    of the prices of its best agent.

    Args:
        restarts: Starts of the serial problem, which has local optima.
        every_n_updates: Updates between two points of the lines.

    Attributes:
        references: Optimum and bound for each pair of prices, once training has started.
        optimum: The best serial solution at the prices of the agent last looked at.
        upper_bound: The certified bound on J at these prices.
    """

    def __init__(self, restarts: int = 32, every_n_updates: int = 100) -> None:
        super().__init__(every_n_updates)
        self.restarts = check_count(restarts, "restarts")
        self.references: dict[Prices, Reference] = {}
        self.optimum: Serial | None = None
        self.upper_bound: float | None = None

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Solves."""
        learner = learner_of(pl_module)
        agent = learner.best_agent()
        prices = list(dict.fromkeys(setting.prices for setting in learner.settings))
        self.references = solve_references(agent, prices, learner.seed, self.restarts)
        self._refer_to(agent)
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger) and self.upper_bound is not None:
                logger.experiment.add_custom_scalars(LAYOUT)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the lines on, and the gap in the bar."""
        self._refer_to(agent)
        lines = {}
        if self.upper_bound is not None:
            lines["objective/upper_bound"] = self.upper_bound
        if self.optimum is not None:
            optimum = float(self.optimum.objective)
            gap = optimum - agent.evaluate().objective
            lines |= {"objective/blahut_arimoto": optimum, "objective/gap": gap}
            trainer.progress_bar_metrics["gap"] = gap
        log_metrics(trainer, agent, lines)

    def _refer_to(self, agent: Agent) -> None:
        reference = self.references[agent.beta_perception, agent.beta_action]
        self.optimum, self.upper_bound = reference.optimum, reference.upper_bound


def baseline_of(trainer: pl.Trainer) -> BaselineMonitor | None:
    """The run's monitor of the optimum, if it has one."""
    callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
    return next((c for c in callbacks if isinstance(c, BaselineMonitor)), None)


def solve_references(
    agent: Agent, prices: Sequence[Prices], seed: int, restarts: int = 32
) -> dict[Prices, Reference]:
    """Optimum and bound of an agent's problem at each pair of prices.

    Args:
        agent: States the problem.
        prices: Pairs (β₁, β₂), solved as one batch.
        seed: Of the restarts.
        restarts: Starts for each pair.
    """
    task = agent.task
    if not (isinstance(task, FiniteTask) and isinstance(agent.percept_space, Discrete)):
        return {pair: Reference(None, _upper_bound(task, *pair)) for pair in prices}
    beta_perception, beta_action = torch.tensor(prices, dtype=torch.double).T
    found = serial(
        task.utilities,
        task.prior,
        int(agent.percept_space.n),
        beta_perception,
        beta_action,
        restarts=restarts,
        seed=seed,
    )
    optima = [_entry(found, index) for index in range(len(prices))]
    pairs = zip(prices, optima, strict=True)
    return {pair: Reference(best, float(best.upper_bound)) for pair, best in pairs}


def solve_optimum(agent: Agent, restarts: int = 32) -> Serial | None:
    """The best serial solution of an agent's problem; None without finite states and percepts."""
    prices = (agent.beta_perception, agent.beta_action)
    return solve_references(agent, [prices], agent.seed, restarts)[prices].optimum


def _upper_bound(task: Task, beta_perception: float, beta_action: float) -> float | None:
    """The bound on J, whatever the percepts; None without a table of utilities.

    By data processing I(Ω;A) ≤ min(I(Ω;X), I(X;A)), so that one channel at
    1/β = 1/β₁ + 1/β₂ does at least as well as the two.
    """
    if not isinstance(task, FiniteTask):
        return None
    beta = 1 / (1 / beta_perception + 1 / beta_action)
    return float(rate_distortion(task.utilities, task.prior, beta).upper_bound)


def _entry(batch: Serial, index: int) -> Serial:
    """One of a batch of solutions, its scalars Python numbers."""
    values: dict[str, Any] = {}
    for name, value in vars(batch).items():
        entry = torch.as_tensor(value)[index]
        values[name] = entry if entry.ndim else entry.item()
    return Serial(**values)
