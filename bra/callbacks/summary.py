"""What a run came to."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch.utilities import rank_zero_only

from bra.agent import Learner
from bra.agent.run_folder import run_folder
from bra.callbacks.advice import advice
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.callbacks.hits import fares
from bra.callbacks.hyperparameters import log_hyperparameters
from bra.callbacks.pairs import pair_lines, population_fields, share_of
from bra.callbacks.schedule import learner_of
from bra.checks.words import amount
from bra.evaluation.references import Reference
from bra.objective import TERMS, bits, digits, finite, saved
from bra.tasks import World


@dataclass(frozen=True)
class Summary:
    """A run in numbers, the fields of `summary.json`.

    None where there is no reference, where actions do not look again, or, for
    `state_information_nats`, where I(Ω;X) is `perception_information_nats` or not known.
    `blahut_arimoto_objective` is the optimum that the sensor allows, wrong by
    `blahut_arimoto_error` at most; `objective_without_sensor_noise` what it would be if a noisy
    sensor had no noise; `standard_errors` those of J and its terms where they are estimated;
    `note` says why there is no optimum, or what to beware of. Of a population the numbers are
    those of its best agent, apart from `replicas`, the number of agents; `hit_rate`, the share
    that reached the optimum at its own prices, with a gap of `hit_threshold` at most, and its 95 %
    interval; `objective_median` and `objective_min`, of J over all agents; and `prices`, the same
    for each pair of prices or budgets, with the median of E[U].
    """

    objective: float
    expected_utility: float
    perception_information_nats: float
    action_information_nats: float
    direct_information_nats: float | None
    end_to_end_information_nats: float | None
    state_information_nats: float | None
    signal_action_information_nats: float | None
    blahut_arimoto_objective: float | None
    blahut_arimoto_error: float
    objective_without_sensor_noise: float | None
    upper_bound: float | None
    gap: float | None
    updates: int
    samples: int
    seconds: float
    seed: int
    note: str
    standard_errors: dict[str, float]
    beta_perception: float
    beta_action: float
    beta_direct: float | None = None
    perception_budget_nats: float | None = None
    action_budget_nats: float | None = None
    replicas: int = 1
    hit_rate: float | None = None
    hit_rate_low: float | None = None
    hit_rate_high: float | None = None
    hit_threshold: float | None = None
    objective_median: float | None = None
    objective_min: float | None = None
    prices: Sequence[dict[str, Any]] = ()

    def fields(self) -> dict[str, Any]:
        """As `summary.json` has them, whose numbers are finite.

        `…_standard_error` is None where nothing was estimated, `beta_action` where it is inf;
        `bound` and `upper_bound` are the same, the least of all bounds there are.
        """
        found = asdict(self) | {"bound": self.upper_bound}
        errors = found.pop("standard_errors")
        found["beta_action"] = finite(self.beta_action)
        return found | {f"{t.key}_standard_error": errors.get(t.key) for t in TERMS.values()}

    @property
    def slack(self) -> float:
        """What a gap may be too large by: the optimum's error, and two standard errors of J."""
        return self.blahut_arimoto_error + 2 * self.standard_errors.get("objective", 0.0)


class RunSummary(pl.Callback):
    """Ends a fit with a short table, and writes `summary.json` into the log directory.

    A test ends with the same table, of the worlds that it looked at.

    A line says what to do next if J misses the optimum by more than 1 % of the range of utilities.

    The optimum and its bound come from the run's `BaselineMonitor`. Loggers are given prices, parts
    and seed of the run as hyperparameters; TensorBoard shows J, gap and hit rate beside them.
    """

    def __init__(self) -> None:
        self._start, self._updates = 0.0, 0

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Starts the clock."""
        self._start, self._updates = time.monotonic(), learner_of(pl_module).updates

    @rank_zero_only
    def on_fit_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Prints and writes."""
        learner, baseline = learner_of(pl_module), baseline_of(trainer)
        summary = summarise(learner, baseline, time.monotonic() - self._start)
        folder = run_folder(trainer)
        folder.file("summary.json").write_text(json.dumps(summary.fields(), indent=2) + "\n")
        fare, _ = fares(learner, baseline)
        shown = {"J": summary.objective, "gap": summary.gap, "hit_rate": fare.hit_rate}
        log_hyperparameters(trainer, learner, shown)
        print(summary_text(summary, folder.path))
        if summary.note:
            print(summary.note)
        gap = None if summary.gap is None else summary.gap - summary.slack
        if learner.updates == self._updates > 0:
            print(nothing_left(trainer, learner.updates))
        elif line := advice(learner.best_agent(), gap, summary.replicas):
            print(line)

    def on_test_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Starts the clock."""
        self._start = time.monotonic()

    @rank_zero_only
    def on_test_batch_end(
        self,
        trainer: pl.Trainer,
        pl_module: pl.LightningModule,
        outputs: Any,
        batch: World,
        *_: Any,
    ) -> None:
        """Prints; a test has one batch."""
        seconds = time.monotonic() - self._start
        summary = summarise(learner_of(pl_module), baseline_of(trainer), seconds, batch)
        print(f"\n{summary_text(summary, Path(trainer.log_dir or trainer.default_root_dir))}")


def nothing_left(trainer: pl.Trainer, updates: int) -> str:
    """What to raise where a resumed run had nothing to do."""
    ends = [f"trainer.max_epochs, {trainer.max_epochs}"] if (trainer.max_epochs or 0) > 0 else []
    ends += [f"trainer.max_steps, {trainer.max_steps}"] if trainer.max_steps > 0 else []
    made = f"the checkpoint has {amount(updates, 'update')}"
    return f"nothing left to do: {made}; raise {' or '.join(ends)}"


def summarise(
    learner: Learner,
    baseline: BaselineMonitor | None,
    seconds: float,
    world: World | None = None,
) -> Summary:
    """A run in numbers; J is estimated, where it is, from the given worlds or those held back."""
    agent = learner.best_agent()
    evaluation = agent.evaluation(world)
    reached = evaluation.objective
    errors = evaluation.standard_error.known() if evaluation.standard_error else {}
    reference = baseline.reference(agent) if baseline else Reference()
    optimum = reference.objective
    limits = agent.budgets.limits if agent.budgets else (None, None)
    return Summary(
        **saved(reached),  # type: ignore[arg-type]  # its keys are those fields
        blahut_arimoto_objective=optimum,
        blahut_arimoto_error=reference.error,
        objective_without_sensor_noise=reference.objective_without_noise,
        upper_bound=reference.bound,
        gap=None if optimum is None else optimum - reached.objective,
        updates=agent.updates,
        samples=agent.samples,
        seconds=seconds,
        seed=agent.seed,
        note=reference.note if baseline else "",
        standard_errors={TERMS[name].key: error for name, error in errors.items()},
        beta_perception=agent.beta_perception,
        beta_action=agent.beta_action,
        beta_direct=agent.beta_direct,
        perception_budget_nats=limits[0],
        action_budget_nats=limits[1],
        **(population_fields(learner, baseline) if len(learner.settings) > 1 else {}),
    )


def _budget_lines(summary: Summary) -> list[str]:
    """Budgets and the prices that lead to them."""
    budgets = {
        "I(Ω;X)": (summary.perception_budget_nats, f"β₁ {summary.beta_perception:.5g}"),
        "I(X;A)": (summary.action_budget_nats, f"β₂ {summary.beta_action:.5g}"),
    }
    return [
        f"{f'  budget of {symbol}':28}{bits(limit):g} bits, at a price of {price} per nat"
        for symbol, (limit, price) in budgets.items()
        if limit is not None
    ]


def summary_text(summary: Summary, folder: Path) -> str:
    """A run for people: information in bits, and no more digits than are known."""
    many, error = summary.replicas > 1, summary.blahut_arimoto_error
    spread = summary.standard_errors
    of_j = spread.get("objective", 0.0)
    rows: dict[str, tuple[float | None, float]] = {
        f"J, best of {summary.replicas} agents" if many else "J": (summary.objective, of_j),
        "  optimum (Blahut-Arimoto)": (summary.blahut_arimoto_objective, error),
        "  gap to the optimum": (summary.gap, math.hypot(error, of_j)),
        "  upper bound" if error else "  certified upper bound": (summary.upper_bound, error),
        "  without sensor noise": (summary.objective_without_sensor_noise, 0),
        "E[U]": (summary.expected_utility, spread.get("expected_utility", 0.0)),
    }
    # A noiseless sensor says all of the state: what perception takes of one it takes of the other.
    noiseless = summary.state_information_nats is summary.signal_action_information_nats is None
    for name, term in TERMS.items():
        value = getattr(summary, term.key)
        if term.in_bits and value is not None:
            taken = noiseless and name == "perception_information"
            symbol = TERMS["state_information"].symbol if taken else term.symbol
            rows[f"{symbol} bits"] = term.shown(value), term.shown(spread.get(term.key, 0.0))
    texts = {n: digits(value, error) for n, (value, error) in rows.items() if value is not None}
    texts["updates"] = f"{summary.updates:,} ({amount(summary.samples, 'world-state')})"
    texts["seconds"] = f"{summary.seconds:.1f}"
    texts["logs"] = str(folder)
    lines = [f"{name:28}{text}" for name, text in texts.items()]
    first = len(lines) - 3  # before updates, seconds and logs
    lines[first:first] = _budget_lines(summary)
    return "\n".join(lines[:1] + _population_lines(summary) + lines[1:])


def _population_lines(summary: Summary) -> list[str]:
    """All agents, and if prices or budgets differ those at each pair."""
    if summary.replicas == 1:
        return []
    error = summary.standard_errors.get("objective")
    lines = []
    if summary.perception_budget_nats is summary.action_budget_nats is None:
        lines = [
            f"{'  median':28}{digits(summary.objective_median or 0.0, error)}",
            f"{'  worst':28}{digits(summary.objective_min or 0.0, error)}",
        ]
    if summary.hit_rate is not None:
        share = share_of(summary.hit_rate, summary.hit_rate_low, summary.hit_rate_high)
        lines.append(f"{'  at the optimum':28}{share}, up to a gap of {summary.hit_threshold:.3g}")
    return lines + pair_lines(summary.prices, error)
