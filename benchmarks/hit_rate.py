"""How often agents reach the optimum: every method on every task, from many seeds.

    python benchmarks/hit_rate.py [--seeds 64] [--seed 0] [--worlds predator-prey mugs …]
        [--methods projection critic …] [--output hit_rate]

A hit is an agent whose J ends within 0.005 times the range of utilities of the best Blahut-Arimoto
optimum. Worlds are predator-prey at five pairs of prices; the mugs at three, on fixed and on
jittered frames; and tables of utilities drawn at random, with priors and prices of their own.
Agents are those of the configurations, with parts taken away or exchanged, and in each world all
have the same network. All seeds and prices of a method are one `bra.Population`, of which 16
successive seeds count as one population of 16, which hits if its best member does. Intervals are
Wilson's, at 95 %, as if tables were drawn anew for every agent.

Prints Markdown tables, and writes hit_rate.csv and hit_rate.png into a folder; rows of an earlier
run that are not measured again stay. All of it takes some half an hour.
"""

import argparse
import csv
import dataclasses
import functools
import statistics
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import matplotlib.pyplot as plt
import torch
from torch import Tensor
from torch.optim import SGD

from bra import Cooling, Population, RolloutDataModule, TableTask
from bra.blahut_arimoto import serial
from bra.callbacks.hits import wilson
from bra.channels import Multinomial
from bra.checkpoints.recipes import from_recipe
from bra.cli.command import BraCLI, quieten
from bra.tasks import FiniteTask
from bra.tasks.nao_mugs import NaoMugs
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction

CONFIGS = Path(__file__).parents[1] / "configs"
HIT = 0.005
"""How far from the optimum, as a share of the range of utilities, an agent may end."""
GROUP = 16
RIVALS, COOLED = "projection, covering, rivals", "projection, covering, cooling"
PROTOCOL = "paper's protocol"
"""Its rule with its own network and sensor, which has no place beside the other rows."""
GROUPED = "populations of 16, rivals (jittered: cooling)"
LOOKS = 50
"""Times that J is looked at in a run."""
RESTARTS = 256
TABLES, TABLES_SEED = 32, 11
QUIET = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")

Prices = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Method:
    """A way to train.

    Attributes:
        config: Configuration that it is a variation of.
        updates: Length of a run.
        changes: Arguments of `Population` in place of the configuration's.
        groups: Populations of 16 to be trained at least; 0 for single agents only.
    """

    config: str
    updates: int
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)
    groups: int = 0


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


def variations(whole: Method, cooling: Cooling, known: bool) -> dict[str, Method]:
    """The projection rule without each of its parts, and the gradient with and without them.

    Args:
        whole: The rule with a covering start and what else the configuration has.
        cooling: Of the methods that have it.
        known: Whether the signals are, so that J has an exact gradient and rivals can compete.
    """

    def without(groups: int = 0, **changes: Any) -> Method:
        plain = {"cooling": None, "update_rule": Projection()}
        return dataclasses.replace(whole, changes=plain | changes, groups=groups)

    gradient = {"update_rule": ExactGradient()}
    methods = {
        "exact gradient": without(action=Multinomial, **gradient),
        "exact gradient, covering, cooling": without(cooling=cooling, **gradient),
        "projection": without(action=Multinomial),
        "projection, covering": without(),
        "projection, cooling": without(action=Multinomial, cooling=cooling),
        COOLED: without(0 if known else whole.groups, cooling=cooling),
        RIVALS: without(whole.groups, update_rule=Projection(rivals=Rivals())),
    }
    unknown = {name for name in methods if "exact" in name or "rivals" in name}
    return methods if known else {n: m for n, m in methods.items() if n not in unknown}


def paper_rule(config: str, rates: Sequence[tuple[float, float]]) -> Method:
    """One encounter per update and plain ascent from a uniform start, at rates for all prices."""
    perception_rate, action_rate = (list(column) for column in zip(*rates, strict=True))
    changes = {
        "action": Multinomial,
        "cooling": None,
        "update_rule": ScoreFunction(),
        "compile": True,
        "perception_optimizer": SGD,
        "action_optimizer": SGD,
        "perception_rate": perception_rate,
        "action_rate": action_rate,
    }
    return Method(config, 100_000, changes)


def worlds() -> dict[str, tuple[Prices, dict[str, Method]]]:
    """Prices and methods of each world but the random tables."""
    prey = ((8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0), (0.5, 0.5))
    mugs = ((2.0, 3.0), (2.0, 0.5), (0.5, 0.5))
    prey_ways = variations(
        Method("predator_prey.yaml", 2000, groups=16), Cooling(16.0, 800, [0.25, 4.0]), True
    )
    mug_ways = variations(
        Method("nao_mugs_high.yaml", 3000, groups=16), Cooling(16.0, 900, 4.0), True
    )
    jitter_ways = variations(
        Method("nao_mugs_jitter.yaml", 3000, groups=4), Cooling(16.0, 900), False
    )
    critic = "critic, taken actions only"
    fixed = {"task": NaoMugs(contrast=True)}
    rates = ((0.035, 0.7), (0.001, 0.34), (0.004, 0.028))
    own = paper_rule("nao_mugs_high.yaml", rates).changes
    kept = {name: own[name] for name in ("compile", "perception_rate", "action_rate")}
    mug_protocol = Method("nao_mugs_online/high.yaml", 100_000, kept)
    return {
        "predator-prey": (
            prey,
            {PROTOCOL: Method("predator_prey_online.yaml", 100_000, {"compile": True})}
            | {"paper's rule": paper_rule("predator_prey.yaml", [(0.006, 0.014)] * len(prey))}
            | prey_ways
            | {critic: Method("predator_prey_critic.yaml", 3000)},
        ),
        "mugs": (
            mugs,
            {PROTOCOL: mug_protocol, "paper's rule": paper_rule("nao_mugs_high.yaml", rates)}
            | mug_ways
            | {critic: Method("nao_mugs_critic.yaml", 8000, fixed)},
        ),
        "mugs, jittered": (mugs, jitter_ways | {critic: Method("nao_mugs_critic.yaml", 8000)}),
    }


def random_tables(count: int, seed: int) -> Iterator[tuple[TableTask, int, float, float]]:
    """Tasks with |X| and prices: 3 to 15 states, 2 to 12 actions, 2 to 16 percepts.

    Utilities are uniform, normal, sparse (three of ten), or one right action per state and a little
    for the others. Priors are uniform for four tables, then for four tables drawn from a Dirichlet
    distribution of parameter 1, and more skewed for every other such four. β is between 0.3 and 20,
    log-uniformly.
    """
    generator = torch.Generator().manual_seed(seed)

    def whole(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.double)

    for number in range(count):
        states, actions, percepts = whole(3, 15), whole(2, 12), whole(2, 16)
        match number % 4:
            case 0:
                utilities = 5 * uniform(states, actions)
            case 1:
                utilities = torch.randn(states, actions, generator=generator, dtype=torch.double)
            case 2:
                utilities = 5 * (uniform(states, actions) < 0.3) * uniform(states, actions)
            case _:
                right = torch.arange(states).unsqueeze(-1) % actions == torch.arange(actions)
                utilities = 3 * right + 0.3 * uniform(states, actions)
        skew = number // 4 % 2 * (1 + number // 8 % 2)
        weights = (-uniform(states).clamp_min(1e-3).log()) ** skew
        beta_1, beta_2 = (0.3 * (20 / 0.3) ** uniform(2)).tolist()
        yield TableTask(utilities, prior=weights / weights.sum()), percepts, beta_1, beta_2


@functools.cache
def configuration(config: str) -> tuple[FiniteTask, dict[str, Any], int]:
    """Task, arguments of a population, and batch size of a configuration."""
    monitors = ("information", "baseline", "population", "behaviour", "summary", "frames")
    with tempfile.TemporaryDirectory() as folder:
        made = BraCLI(
            "fit",
            [
                *(f"--config={CONFIGS / config}", "--model.replicas=2"),
                *("--trainer.max_steps=0", f"--trainer.default_root_dir={folder}"),
                *(f"--{name}=null" for name in monitors),
                *(f"--trainer.{switch}=false" for switch in QUIET),
            ],
        )
    recipe = {part: value for part, value in made.model.recipe.items() if part != "task"}
    return made.model.task, recipe, made.datamodule.batch_size


class Looks(pl.Callback):
    """J of every member at 50 moments of a run."""

    def __init__(self, updates: int) -> None:
        self.every_n_updates = updates // LOOKS
        self.objectives: list[Tensor] = []

    def on_train_batch_end(self, trainer: pl.Trainer, pl_module: Any, *_: Any) -> None:
        """Looks."""
        if pl_module.updates % self.every_n_updates == 0:
            self.objectives.append(pl_module.objectives())


def train(method: Method, **own: Any) -> tuple[Population, Tensor, int, float]:
    """Trains a population of the configuration, with changes.

    Returns:
        The population, J at all looks (looks, R), its batch size, and the seconds that it took.
    """
    known, recipe, batch_size = configuration(method.config)
    kept = {part: value for part, value in recipe.items() if part not in method.changes | own}
    started = time.perf_counter()
    population = Population(**{"task": known} | from_recipe(kept) | method.changes | own)
    looks = Looks(method.updates)
    trainer = pl.Trainer(
        max_epochs=1, limit_val_batches=0, callbacks=[looks], **dict.fromkeys(QUIET, False)
    )
    data = RolloutDataModule(population.task, batch_size, method.updates)
    trainer.fit(population, data)
    return population, torch.stack(looks.objectives), batch_size, time.perf_counter() - started


def rows_of(
    world: str, name: str, method: Method, prices: Prices, own: dict[str, Any]
) -> Iterator[Row]:
    """Trains a method on all seeds and prices of a world at once: a row for each pair of prices."""
    betas = dict(zip(("beta_perception", "beta_action"), zip(*prices, strict=True), strict=True))
    replicas = max(own["replicas"], GROUP * method.groups)
    population, course, batch_size, seconds = train(method, **own | {"replicas": replicas} | betas)
    percepts = int(population.percept_space.n)
    for (beta_1, beta_2), part in zip(prices, course.split(replicas, 1), strict=True):
        found = serial(
            population.task.utilities, population.task.prior, percepts, beta_1, beta_2, RESTARTS
        )
        table = population.task.utilities
        least = found.objective - HIT * (table.max() - table.min()).item()
        within = part > least
        hit, grouped = within[-1], part[-1, : replicas // GROUP * GROUP].view(-1, GROUP)
        # The first look from which on it stays a hit.
        stays = within.flip(0).cumprod(0).sum(0)[hit]
        needed = ((LOOKS - stays + 1) * (method.updates // LOOKS)).tolist()
        median = statistics.median(needed) if needed else None
        sees = population.world_seeds is not None
        yield Row(
            world,
            beta_1,
            beta_2,
            name,
            replicas,
            int(hit.sum()),
            len(grouped) if method.groups else 0,
            int((grouped.amax(1) > least).sum()) if method.groups else 0,
            part[-1].median().item(),
            part[-1].min().item(),
            part[-1].max().item(),
            found.objective,
            method.updates,
            median,
            median * batch_size if sees and median is not None else None,
            seconds,
        )


def rows_of_tables(seeds: int, seed: int, names: Sequence[str]) -> Iterator[Row]:
    """The methods on random tables, each table a run of its own."""
    _, methods = worlds()["predator-prey"]
    chosen = {
        name: dataclasses.replace(methods[name], groups=seeds // GROUP)
        for name in ("exact gradient", "projection", COOLED, RIVALS)
    }
    for name, method in chosen.items():
        for task, percepts, *betas in random_tables(TABLES, TABLES_SEED):
            if name in names:
                own = {"task": task, "replicas": seeds, "seed": seed, "percepts": percepts}
                yield from rows_of("tables", name, method, (tuple(betas),), own)


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


def main() -> None:
    """Runs what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = worlds()
    names = dict.fromkeys(name for _, methods in known.values() for name in methods)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--worlds", nargs="+", choices=[*known, "tables"], metavar="WORLD")
    parser.add_argument("--methods", nargs="+", choices=names, metavar="METHOD")
    parser.add_argument("--output", type=Path, default=Path("hit_rate"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    quieten()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "hit_rate.csv"
    methods, wanted = options.methods or list(names), options.worlds or [*known, "tables"]
    rows = {row.key: row for row in read_rows(path)}
    for row in all_rows(known, wanted, methods, options.seeds, options.seed):
        rows[row.key] = row
        print(table([row]).splitlines()[-1], flush=True)
        write_rows(path, rows.values())
    order = [*known, "tables"], list(names)
    found = sorted(rows.values(), key=lambda r: (order[0].index(r.world), order[1].index(r.method)))
    write_rows(path, found)
    print(f"\n{table(found)}\n\n{share_table(found)}\n\n{summary_of_tables(found)}")
    draw(found, options.output / "hit_rate.png")


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


def all_rows(
    known: dict[str, tuple[Prices, dict[str, Method]]],
    wanted: Sequence[str],
    methods: Sequence[str],
    seeds: int,
    seed: int,
) -> Iterator[Row]:
    """Rows of the worlds and methods that are wanted."""
    own = {"replicas": seeds, "seed": seed}
    for world, (prices, ways) in known.items():
        for name, method in ways.items():
            if world in wanted and name in methods:
                yield from rows_of(world, name, method, prices, own)
    if "tables" in wanted:
        yield from rows_of_tables(seeds, seed, methods)


if __name__ == "__main__":
    main()
