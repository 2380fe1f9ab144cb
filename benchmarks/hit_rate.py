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
import dataclasses
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from methods import GROUP, QUIET, Method, Prices, configuration, random_tables, worlds
from rows_of_hits import (
    COOLED,
    HIT,
    RIVALS,
    Row,
    draw,
    read_rows,
    share_table,
    summary_of_tables,
    table,
    write_rows,
)
from torch import Tensor

from bra import Population, RolloutDataModule
from bra.blahut_arimoto import serial
from bra.checkpoints.recipes import from_recipe
from bra.cli.command import quieten

LOOKS = 50
"""Times that J is looked at in a run."""
RESTARTS = 256
TABLES, TABLES_SEED = 32, 11


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
