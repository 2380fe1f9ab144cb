"""How all agents of a population fare."""

import csv
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

from bra.agent import Agent, Learner
from bra.agent.run_folder import run_folder
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.callbacks.schedule import Monitor, learner_of, log_metrics
from bra.objective import TERMS
from bra.tasks import FiniteTask, Task

HIT = 0.005
"""Share of the range of utilities up to which an agent may miss an optimum that it has reached."""


class PopulationMonitor(Monitor):
    """Logs the spread of J over a population, and writes a table of its agents in the end.

    Logged keys: `population/J_best`, `population/J_median`, `population/J_min`; and, beside a
    `BaselineMonitor`, `population/hit_rate`, the share of agents that reached the optimum at
    their own prices. `population.csv` in the log directory has a row per agent: its settings, J,
    gap, E[U] and informations. A run of one agent leaves nothing.

    Args:
        every_n_updates: Updates between two points of the curves.
    """

    def __init__(self, every_n_updates: int = 100) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Evaluates all agents and logs what comes out."""
        learner = learner_of(trainer.lightning_module)
        if len(learner.settings) == 1:
            return
        objectives = learner.objectives()
        metrics = {
            "population/J_best": objectives.max().item(),
            "population/J_median": objectives.quantile(0.5).item(),
            "population/J_min": objectives.min().item(),
        }
        share = hit_rate(learner, baseline_of(trainer))
        if share is not None:
            metrics["population/hit_rate"] = trainer.progress_bar_metrics["hits"] = share
        log_metrics(trainer, agent, metrics)

    @rank_zero_only
    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Writes the table."""
        learner = learner_of(pl_module)
        if len(learner.settings) > 1:
            rows = population_rows(learner, baseline_of(trainer))
            path = run_folder(trainer).file("population.csv")
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, rows[0].keys())
                writer.writeheader()
                writer.writerows(rows)


def gaps(learner: Learner, baseline: BaselineMonitor | None) -> Tensor | None:
    """Optimum at its own prices minus J of each agent, (R,); None where no optimum is known."""
    if baseline is None:
        return None
    optima = [baseline.references[setting.prices].objective for setting in learner.settings]
    objectives = learner.objectives()
    known = [optimum for optimum in optima if optimum is not None]
    return objectives.new_tensor(known) - objectives if len(known) == len(objectives) else None


def hit_rate(learner: Learner, baseline: BaselineMonitor | None) -> float | None:
    """Share of agents that reached the optimum at their own prices; None where none is known."""
    missing, threshold = gaps(learner, baseline), hit_threshold(learner.task)
    if missing is None or threshold is None:
        return None
    return (missing <= threshold).double().mean().item()


def hit_threshold(task: Task) -> float | None:
    """Gap to the optimum, in units of utility, up to which an agent has reached it.

    A fixed share of the range of utilities, so that it means the same in any unit; None without a
    table of utilities.
    """
    return HIT * task.utility_range if isinstance(task, FiniteTask) else None


def population_rows(learner: Learner, baseline: BaselineMonitor | None) -> list[dict[str, Any]]:
    """A row per agent: its settings, J and its terms, and its gap; empty where one is not known."""
    terms = learner.evaluate_members()
    columns = {term.key: getattr(terms, name) for name, term in TERMS.items()}
    columns["gap"] = gaps(learner, baseline)
    return [
        vars(setting)
        | {n: None if column is None else column[i].item() for n, column in columns.items()}
        for i, setting in enumerate(learner.settings)
    ]
