"""How often a newcomer with a CSV file and prices gets to the optimum at the first try.

    python benchmarks/first_try.py [--tables 40] [--first 0] [--updates 10000] [--seed 1]
        [--replicas 1]

Draws tables of utilities with 3 to 30 states and 2 to 20 actions, of scales from 1e-3 to 1e3, with
priors from uniform to very skewed, prices β times scale from 0.3 to 40, and a number of percepts
for four of every eight tables; writes each as a CSV file; and lets `bra fit` train one agent on it
with nothing else said, or a population. A try gets there if it ends within 1 % of the range of
utilities of the best optimum that `serial` finds. Prints a row per table, as Markdown, and the
share with Wilson's 95 % interval.
"""

import argparse
import csv
import io
import json
import math
import tempfile
import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Generator, Tensor

from bra.callbacks.hits import wilson
from bra.cli.command import BraCLI, quieten

CLOSE = 0.01
"""Share of the range of utilities that a try may miss."""


@dataclass(frozen=True)
class Problem:
    """A table, and what a newcomer says of it."""

    utilities: Tensor
    prior: Tensor
    percepts: int | None
    beta_perception: float
    beta_action: float

    @property
    def utility_range(self) -> float:
        """The largest utility less the smallest."""
        return (self.utilities.max() - self.utilities.min()).item()


def draw_problem(number: int, seed: int) -> Problem:
    """The problem of a number, the same for the same seed."""
    generator = Generator().manual_seed(1000 * seed + number)

    def along(low: float, high: float) -> float:
        return low * (high / low) ** torch.rand((), generator=generator).item()

    def whole(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    states, actions = whole(3, 30), whole(2, 20)
    uniform = torch.rand(states, actions, generator=generator, dtype=torch.double)
    normal = torch.randn(states, actions, generator=generator, dtype=torch.double)
    right = torch.arange(states).unsqueeze(-1) % actions == torch.arange(actions)
    kinds = (uniform, normal / 4, uniform * (normal > 0.5), 0.6 * right + 0.1 * uniform)
    scale = along(1e-3, 1e3)
    weights = (
        torch.rand(states, generator=generator, dtype=torch.double).clamp_min(1e-3).log().neg()
    )
    prior = weights ** along(0.1, 4.0) if number % 3 else torch.ones_like(weights)
    return Problem(
        scale * kinds[number % 4],
        prior / prior.sum(),
        whole(2, 16) if number // 4 % 2 else None,
        along(0.3, 40.0) / scale,
        along(0.3, 40.0) / scale,
    )


def try_once(problem: Problem, updates: int, replicas: int, folder: Path) -> dict[str, float]:
    """What `bra fit` says in the end of a run with defaults."""
    _, actions = problem.utilities.shape
    with (folder / "table.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["", *(f"a{i}" for i in range(actions))])
        writer.writerows([f"s{i}", *row] for i, row in enumerate(problem.utilities.tolist()))
    asked = [
        "--data.task=TableTask",
        f"--data.task.utilities={folder / 'table.csv'}",
        f"--data.task.prior={problem.prior.tolist()}",
        f"--model.beta_perception={problem.beta_perception}",
        f"--model.beta_action={problem.beta_action}",
        f"--trainer.max_steps={updates}",
        f"--trainer.max_epochs={-(-updates // 1000)}",
        f"--trainer.default_root_dir={folder}",
        "--trainer.logger=false",
        "--trainer.enable_progress_bar=false",
        "--trainer.enable_checkpointing=false",
    ]
    if replicas > 1:
        asked.append(f"--model.replicas={replicas}")
    if problem.percepts is not None:
        asked.append(f"--model.percepts={problem.percepts}")
    with redirect_stdout(io.StringIO()):
        BraCLI("fit", asked)
    (summary,) = folder.rglob("summary.json")
    return json.loads(summary.read_text())


def main() -> None:
    """Runs what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--updates", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--replicas", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    quieten()
    print(
        "| table | states, actions, percepts | β₁, β₂ times range | gap / range | s |\n"
        + "|---" * 5
        + "|"
    )
    missed = []
    for number in range(options.first, options.first + options.tables):
        problem, started = draw_problem(number, options.seed), time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            found = try_once(problem, options.updates, options.replicas, Path(folder))
        gap = found["gap"] / problem.utility_range
        betas = (problem.utility_range * b for b in (problem.beta_perception, problem.beta_action))
        cells = (
            str(number),
            ", ".join(map(str, (*problem.utilities.shape, problem.percepts or "not given"))),
            ", ".join(f"{beta:.3g}" for beta in betas),
            f"{gap:.5f}{' (missed)' if not gap <= CLOSE else ''}",
            f"{time.perf_counter() - started:.0f}",
        )
        print("| " + " | ".join(cells) + " |", flush=True)
        missed.append(not gap <= CLOSE or math.isnan(gap))
    hits, tries = len(missed) - sum(missed), len(missed)
    low, high = wilson(hits, tries)
    print(f"\n{hits} of {tries} ({low:.3f}–{high:.3f}) within {CLOSE:.0%} of the range")


if __name__ == "__main__":
    main()
