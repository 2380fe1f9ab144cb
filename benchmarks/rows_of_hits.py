"""Rows of hit rates: as Markdown, as a file, as a picture."""

import csv
import dataclasses
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import torch

from bra.callbacks.hits import wilson

HIT = 0.005
"""How far from the optimum, as a share of the range of utilities, an agent may end."""
RIVALS, COOLED = "projection, covering, rivals", "projection, covering, cooling"
PROTOCOL = "paper's protocol"
"""Its rule with its own network and sensor, which has no place beside the other rows."""
GROUPED = "populations of 16, rivals (jittered: cooling)"


@dataclasses.dataclass(frozen=True)
class Row:
    """What came of a method at one pair of prices."""

    world: str
    beta_perception: float
    beta_action: float
    method: str
    seeds: int
    hits: int
    populations: int
    population_hits: int
    median_objective: float
    lowest_objective: float
    highest_objective: float
    optimum: float
    updates: int
    updates_needed: float | None
    worlds_needed: float | None
    seconds: float

    @property
    def key(self) -> tuple[Any, ...]:
        """What it is about."""
        return self.world, self.method, self.beta_perception, self.beta_action

    @property
    def column(self) -> str:
        """Where it stands in the picture."""
        if self.world == "tables":
            return "random\ntables"
        return f"{self.world}\n{self.beta_perception:g}, {self.beta_action:g}"


def table(rows: Sequence[Row]) -> str:
    """Rows as Markdown."""
    head = (
        "world",
        "β₁, β₂",
        "method",
        "hits",
        "populations of 16",
        "median J",
        "optimum",
        "updates needed",
        "world-states needed",
        "s",
    )
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        cells = (
            row.world,
            f"{row.beta_perception:.3g}, {row.beta_action:.3g}",
            row.method,
            f"{row.hits} of {row.seeds} ({interval(row.hits, row.seeds)})",
            f"{row.population_hits} of {row.populations}" if row.populations else "",
            f"{row.median_objective:.4f}",
            f"{row.optimum:.4f}",
            "" if row.updates_needed is None else f"{row.updates_needed:.0f} of {row.updates}",
            "" if row.worlds_needed is None else f"{row.worlds_needed:.0f}",
            f"{row.seconds:.0f}",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def interval(hits: int, trials: int) -> str:
    """Wilson's interval of a share, as text."""
    low, high = wilson(hits, trials)
    return f"{low:.3f}–{high:.3f}"


def summary_of_tables(rows: Sequence[Row]) -> str:
    """Hits of agents and of populations on all random tables, with intervals, as Markdown."""
    lines = ["| method | agents | interval | populations of 16 | interval |", "|" + "---|" * 5]
    tables = [row for row in rows if row.world == "tables"]
    for name in dict.fromkeys(row.method for row in tables):
        own = [row for row in tables if row.method == name]
        counts = [(sum(row.hits for row in own), sum(row.seeds for row in own))]
        counts += [(sum(row.population_hits for row in own), sum(row.populations for row in own))]
        cells = [f"{hits} of {trials} | {interval(hits, trials)}" for hits, trials in counts]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def shares_of(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Share of hits of every method in every column; of several tables the mean."""
    rows = [row for row in rows if row.method != PROTOCOL]
    found: dict[str, dict[str, list[float]]] = {row.method: {} for row in rows}
    for row in rows:
        found[row.method].setdefault(row.column, []).append(row.hits / row.seeds)
        if row.populations and row.method == (COOLED if "jittered" in row.world else RIVALS):
            share = row.population_hits / row.populations
            found.setdefault(GROUPED, {}).setdefault(row.column, []).append(share)
    return {
        name: {column: statistics.mean(values) for column, values in columns.items()}
        for name, columns in found.items()
    }


def share_table(rows: Sequence[Row]) -> str:
    """Share of hits as Markdown, a row per method."""
    columns = list(dict.fromkeys(row.column for row in rows))
    head = [column.replace("\n", " ") for column in columns]
    lines = ["| | " + " | ".join(head) + " |", "|" + "---|" * (len(head) + 1)]
    for name, shares in shares_of(rows).items():
        cells = (f"{shares[column]:.2f}" if column in shares else "" for column in columns)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Share of hits, a row per method and a column per world and prices."""
    columns = list(dict.fromkeys(row.column for row in rows))
    shares = shares_of(rows)
    names = list(shares)
    figure, axes = plt.subplots(figsize=(1.0 * len(columns) + 3.5, 0.5 * len(names) + 1.6))
    grid = torch.full((len(names), len(columns)), torch.nan)
    for y, name in enumerate(names):
        for column, share in shares[name].items():
            x = columns.index(column)
            grid[y, x] = share
            colour = "white" if share < 0.5 else "black"
            axes.text(x, y, f"{share:.2f}", ha="center", va="center", color=colour)
    image = axes.imshow(grid, vmin=0, vmax=1, cmap="viridis", aspect="auto")
    axes.set_xticks(range(len(columns)), columns, fontsize=8)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.set_title(
        f"Share of seeds that end within {HIT} × range of utilities of the optimum", loc="left"
    )
    figure.colorbar(image, label="share of seeds", pad=0.02)
    figure.savefig(path, dpi=130, bbox_inches="tight")


def read_rows(path: Path) -> list[Row]:
    """Rows of an earlier run; none if there is no file."""
    if not path.is_file():
        return []
    types = {"world": str, "method": str, "updates_needed": _number, "worlds_needed": _number}
    counts = ("seeds", "hits", "populations", "population_hits", "updates")
    types |= dict.fromkeys(counts, int)
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Row(**{name: types.get(name, float)(text) for name, text in line.items()})
            for line in csv.DictReader(file)
        ]


def _number(text: str) -> float | None:
    return float(text) if text else None


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Writes the file anew."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in dataclasses.fields(Row)])
        writer.writeheader()
        writer.writerows(vars(row) for row in rows)
