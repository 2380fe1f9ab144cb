"""What a run came to."""

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.utilities import rank_zero_only

from bra.agent import Agent
from bra.callbacks.advice import advice
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.callbacks.population import hit_rate
from bra.callbacks.schedule import agent_of
from bra.objective import bits
from bra.population.population import Population


@dataclass(frozen=True)
class Summary:
    """A run in numbers, the fields of `summary.json`.

    None where there is no reference, or, for `state_information_nats`, where I(Ω;X) is
    `perception_information_nats` or not known. Of a population the numbers are those of its best
    agent, apart from `replicas`, the number of agents; `hit_rate`, the share that reached the
    optimum at its own prices; and `objective_median` and `objective_min`, of J over all agents.
    """

    objective: float
    expected_utility: float
    perception_information_nats: float
    action_information_nats: float
    end_to_end_information_nats: float | None
    state_information_nats: float | None
    blahut_arimoto_objective: float | None
    upper_bound: float | None
    gap: float | None
    updates: int
    samples: int
    seconds: float
    seed: int
    replicas: int = 1
    hit_rate: float | None = None
    objective_median: float | None = None
    objective_min: float | None = None


class RunSummary(pl.Callback):
    """Ends a fit with a short table, and writes `summary.json` into the log directory.

    A line says what to do next if J misses the optimum by more than 1 % of the range of utilities.

    The optimum and its bound come from the run's `BaselineMonitor`.
    """

    def __init__(self) -> None:
        self._start = 0.0

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Starts the clock."""
        self._start = time.monotonic()

    @rank_zero_only
    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Prints and writes."""
        agent = agent_of(pl_module)
        baseline = baseline_of(trainer)
        summary = summarise(agent, baseline, time.monotonic() - self._start)
        if isinstance(pl_module, Population):
            summary = replace(summary, **population_fields(pl_module, baseline))
        folder = Path(trainer.log_dir or trainer.default_root_dir)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "summary.json").write_text(json.dumps(asdict(summary), indent=2) + "\n")
        print(summary_text(summary, folder))
        if line := advice(agent, summary.gap, summary.replicas):
            print(line)


def summarise(agent: Agent, baseline: BaselineMonitor | None, seconds: float) -> Summary:
    """A run in numbers."""
    reached = agent.evaluate()
    optimum = float(baseline.optimum.objective) if baseline and baseline.optimum else None
    return Summary(
        objective=reached.objective,
        expected_utility=reached.expected_utility,
        perception_information_nats=reached.perception_information,
        action_information_nats=reached.action_information,
        end_to_end_information_nats=reached.end_to_end_information,
        state_information_nats=reached.state_information,
        blahut_arimoto_objective=optimum,
        upper_bound=baseline.upper_bound if baseline else None,
        gap=None if optimum is None else optimum - reached.objective,
        updates=agent.updates,
        samples=agent.samples,
        seconds=seconds,
        seed=agent.seed,
    )


def population_fields(population: Population, baseline: BaselineMonitor | None) -> dict[str, Any]:
    """What a summary says of all agents."""
    objectives = population.objectives()
    return {
        "replicas": len(population),
        "hit_rate": hit_rate(population, baseline),
        "objective_median": objectives.quantile(0.5).item(),
        "objective_min": objectives.min().item(),
    }


def summary_text(summary: Summary, folder: Path) -> str:
    """A run for people: information in bits."""
    rows: dict[str, float | None] = {
        "J"
        if summary.replicas == 1
        else f"J, best of {summary.replicas} agents": summary.objective,
        "  median": summary.objective_median,
        "  worst": summary.objective_min,
        "  share at the optimum": summary.hit_rate,
        "  optimum (Blahut-Arimoto)": summary.blahut_arimoto_objective,
        "  gap to the optimum": summary.gap,
        "  certified upper bound": summary.upper_bound,
        "E[U]": summary.expected_utility,
    }
    if summary.state_information_nats is None:
        rows["I(Ω;X) bits"] = bits(summary.perception_information_nats)
    else:
        rows["I(ξ;X) bits"] = bits(summary.perception_information_nats)
        rows["I(Ω;X) bits"] = bits(summary.state_information_nats)
    rows["I(X;A) bits"] = bits(summary.action_information_nats)
    texts = {name: f"{value:.5f}" for name, value in rows.items() if value is not None}
    texts["updates"] = f"{summary.updates:,} ({summary.samples:,} world-states)"
    texts["seconds"] = f"{summary.seconds:.1f}"
    texts["logs"] = str(folder)
    return "\n".join(f"{name:28}{text}" for name, text in texts.items())
