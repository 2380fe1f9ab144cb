"""How all agents of a population fare."""

import csv
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.utilities import rank_zero_only

from bra.agent import Agent, Learner
from bra.agent.run_folder import run_folder
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.callbacks.curves import append_rows
from bra.callbacks.hits import fares, gaps
from bra.callbacks.schedule import CurveMonitor, learner_of, log_metrics
from bra.objective import TERMS


class PopulationMonitor(CurveMonitor):
    """Logs the spread of J over a population, and writes a table of its agents in the end.

    Logged keys: `population/J_best`, `population/J_median`, `population/J_min`; and, beside a
    `BaselineMonitor`, `population/hit_rate`, the share of agents that reached the optimum at their
    own prices, with `…_low` and `…_high`, its 95 % interval (Wilson's). `population.csv` in the log
    directory has a row per agent: its settings, J, gap, E[U] and informations; `curves.csv` one per
    agent and look, which a resumed run goes on with. A run of one agent leaves nothing.

    Args:
        every_n_updates: Updates between two points of the curves; None is 100 (of more
            than 256 agents 200, …), and a hundredth of runs of more than 10 000 updates.
    """

    def __init__(self, every_n_updates: int | None = None) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Evaluates all agents and logs what comes out."""
        learner = learner_of(trainer.lightning_module)
        if len(learner.settings) == 1:
            return
        fare, _ = fares(learner, baseline_of(trainer))
        metrics = {
            "population/J_best": fare.objective_best,
            "population/J_median": fare.objective_median,
            "population/J_min": fare.objective_min,
            "population/hit_rate": fare.hit_rate,
            "population/hit_rate_low": fare.hit_rate_low,
            "population/hit_rate_high": fare.hit_rate_high,
        }
        if fare.hit_rate is not None:
            trainer.progress_bar_metrics["hits"] = fare.hit_rate
        log_metrics(trainer, {n: v for n, v in metrics.items() if v is not None})
        rows = population_rows(learner, baseline_of(trainer))
        if trainer.is_global_zero:
            numbered = enumerate(rows)
            append_rows(
                trainer, [{"updates": learner.updates, "agent": n} | r for n, r in numbered]
            )

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


def population_rows(learner: Learner, baseline: BaselineMonitor | None) -> list[dict[str, Any]]:
    """A row per agent: its settings, J and its terms, and its gap; empty where one is not known."""
    terms = learner.evaluate_members()
    columns = {term.key: getattr(terms, name) for name, term in TERMS.items()}
    columns |= {"objective_standard_error": terms.standard_error, "gap": gaps(learner, baseline)}
    none = [None] * len(learner.settings)
    values = zip(*(none if c is None else c.tolist() for c in columns.values()), strict=True)
    return [
        vars(setting) | dict(zip(columns, own, strict=True))
        for setting, own in zip(learner.settings, values, strict=True)
    ]
