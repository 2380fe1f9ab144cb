"""Agent-updates per second of the paper's rule: blocks of updates beside JAX and NumPy.

    python benchmarks/throughput.py [--sizes 1 16 256 2048] [--repeats 7] [--device cpu]
        [--output throughput]

Needs JAX: pip install "bra[benchmarks]". Everybody makes the same update, that of
`configs/predator_prey_online.yaml` in float32: one encounter per agent, drawn anew, exact
marginals, plain gradient ascent with a rate for each channel.

plain JAX: the same with `jax.random.categorical` and `jax.value_and_grad`, as it is written first.
    It has the loss of JAX's rule and differs in its draws alone.
JAX: what one would write by hand for this one rule, `jax.vmap` over agents and `jax.lax.scan` over
    updates. Outcomes are drawn as bra draws them, by the inverse of the distribution function from
    one uniform number each, which is faster than `jax.random.categorical`.
NumPy: a loop in Python with the derivatives by hand, one agent after the other.
eager: updates one by one, uncompiled, in `Trainer.fit`, without monitors.
blocks: blocks of 1 000 updates and their worlds, without a trainer.
Trainer: the same in `Trainer.fit`, with counters, checks, data loader, loops and the monitors of
    the command at their defaults: optimum, curves, pictures and TensorBoard, in runs of some ten
    seconds, and of 20 000 updates at least: shorter ones are not made in blocks by default.
projection, eager projection: the projection rule with Adam, in `Trainer.fit` without monitors.

Before anything is timed, the rules of JAX and NumPy are checked to have bra's gradient at the same
encounters. On the CPU all have one thread, and one core. Contestants take turns; medians are
compared. Prints a Markdown table; writes throughput.csv and throughput.png into a folder.
"""

import argparse
import csv
import io
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import matplotlib.pyplot as plt
import numpy as np
import torch
from by_hand import (
    PRICES,
    RATES,
    JaxRule,
    NumPyRule,
    PlainJaxRule,
    check_gradients,
    jax,
    make_agents,
    stacked_parameters,
    to_jax,
)
from lightning.pytorch.callbacks import ProgressBar
from torch.optim import Adam

import bra
from bra import Agent, Population, RolloutDataModule
from bra.agent.trained import PAYS
from bra.blocks import Blocks
from bra.cli.command import quieten
from bra.tasks import World
from bra.tasks.base import Block
from bra.tasks.datamodule import WorldStream
from bra.update_rules import Projection

SECONDS, MONITORED = 0.3, 10.0
"""What a measurement is to take, roughly, without monitors and with them."""
NAMES = (
    *("JAX", "plain JAX", "NumPy", "eager", "blocks", "Trainer"),
    *("projection", "eager projection"),
)


Run = Callable[[int], float]
"""Makes so many updates, and tells the seconds that they took."""


def numpy_run(rule: NumPyRule, size: int) -> Run:
    """Updates by NumPy, agent by agent."""
    stacks = [stack.detach().numpy() for stack in stacked_parameters(make_agents(size, False))]
    agents = [[s.copy() for s in of_one] for of_one in zip(*stacks, strict=True)]
    rates = (RATES[0], *RATES)
    generator = np.random.default_rng(0)

    def run(updates: int) -> float:
        start = time.perf_counter()
        for parameters in agents:
            for numbers in generator.random((updates, 3), np.float32):
                state = rule.draw(rule.prior, numbers[0])
                gradients = rule.gradient(*parameters, state, numbers[1:])
                for parameter, gradient, rate in zip(parameters, gradients, rates, strict=True):
                    parameter -= rate * gradient
        return time.perf_counter() - start

    return run


def jax_run(rule: JaxRule, size: int) -> Run:
    """Updates by JAX; compiles for each new number of them."""
    parameters = to_jax(stacked_parameters(make_agents(size, compile=False)))
    keys = jax.random.split(jax.random.key(0), size)

    def run(updates: int) -> float:
        start = time.perf_counter()
        jax.block_until_ready(rule.updates(parameters, keys, updates))
        return time.perf_counter() - start

    return run


def block_run(size: int, device: torch.device) -> Run:
    """Blocks of updates without a trainer."""
    agents = make_agents(size, compile=True).to(device)
    seeds = getattr(agents, "world_seeds", None) or agents.seed
    worlds = WorldStream(agents.task, 1, seeds, "world")
    optimizers, _ = agents.configure_optimizers()
    blocks = Blocks(numbers=5 * size)

    def run(updates: int) -> float:
        start = time.perf_counter()
        for first in range(agents.updates, agents.updates + updates, blocks.capacity):
            count = min(blocks.capacity, agents.updates + updates - first)
            block = worlds[range(first, first + count)]
            block = Block(World(*(part.to(device) for part in block.world)), *block[1:])
            prices = torch.tensor(PRICES, device=device)
            prices = prices.reshape(1, 2, 1).expand(count, 2, size)
            rates = torch.tensor(RATES, device=device).expand(count, 2)
            blocks.make(
                agents.all_agents(optimizers, None), block, prices, partial(torch.clone, rates)
            )
        agents.updates += updates
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - start

    return run


class Clock(pl.Callback):
    """Takes the time from the first update to the last."""

    def on_train_start(self, *_: Any) -> None:
        """Starts."""
        self.start = time.perf_counter()

    def on_train_end(self, *_: Any) -> None:
        """Stops."""
        self.seconds = time.perf_counter() - self.start


def trainer_run(agents: Agent | Population, device: torch.device, watched: bool = False) -> Run:
    """Updates in `Trainer.fit`, with the monitors of the command or without."""

    def run(updates: int) -> float:
        clock, agents.run = Clock(), None  # a run of its own
        monitors = [m for m in bra.monitors() if watched and not isinstance(m, ProgressBar)]
        with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
            trainer = pl.Trainer(
                max_epochs=1,
                accelerator="gpu" if device.type == "cuda" else "cpu",
                devices=1,
                limit_val_batches=0,
                callbacks=[clock, *monitors],
                default_root_dir=folder,
                enable_checkpointing=False,
                enable_progress_bar=False,
                enable_model_summary=False,
            )
            trainer.fit(agents, RolloutDataModule(agents.task, 1, updates))
        return clock.seconds

    return run


@dataclass(frozen=True)
class Result:
    """Agent-updates per second of one contestant."""

    name: str
    agents: int
    median: float
    lowest: float
    highest: float


def measure(
    size: int, rules: tuple[JaxRule, JaxRule, NumPyRule], device: torch.device, repeats: int
) -> list[Result]:
    """Lets the contestants take turns."""
    rule, plain, own = rules
    with_adam = {"rule": Projection(), "optimizer": Adam}
    makers = (
        lambda: jax_run(rule, size),
        lambda: jax_run(plain, size),
        lambda: numpy_run(own, size),
        lambda: trainer_run(make_agents(size, False), device),
        lambda: block_run(size, device),
        lambda: trainer_run(make_agents(size, True), device, watched=True),
        lambda: trainer_run(make_agents(size, True, **with_adam), device),
        lambda: trainer_run(make_agents(size, False, **with_adam), device),
    )
    runs = [make() for make in makers]
    counts = []
    for run in runs:
        run(3)
        count = 20
        for _ in range(2):  # twice, since few updates take longer than their share
            run(count)  # JAX compiles for each number
            count = max(20, round(count * SECONDS / run(count)))
        run(count)
        counts.append(count)
    whole = round(counts[NAMES.index("blocks")] * MONITORED / SECONDS)
    counts[NAMES.index("Trainer")] = max(PAYS, whole)
    # Each fit records anew what it compiles, or finds, for which long runs make up.
    counts[NAMES.index("projection")] = whole // 8
    turns = [[run(n) for run, n in zip(runs, counts, strict=True)] for _ in range(repeats)]
    results = []
    for name, count, times in zip(NAMES, counts, zip(*turns, strict=True), strict=True):
        rates = [size * count / taken for taken in times]
        results.append(Result(name, size, statistics.median(rates), min(rates), max(rates)))
    return results


def print_table(results: Sequence[Result]) -> None:
    """A row per size: agent-updates per second, and their ratios to JAX."""
    medians = {(result.agents, result.name): result.median for result in results}
    others = ("NumPy", "blocks", "Trainer")
    print(f"| agents | {' | '.join(NAMES)} | {' | '.join(f'{n} / JAX' for n in others)} |")
    print("|" + "---|" * (1 + len(NAMES) + len(others)))
    for size in sorted({result.agents for result in results}):
        rates = [medians[size, name] for name in NAMES]
        ratios = [f"{medians[size, name] / rates[0]:.2f}" for name in others]
        shown = [f"{rate:,.0f}".replace(",", " ") for rate in rates]
        print(f"| {size} | {' | '.join(shown + ratios)} |", flush=True)


def write_results(results: Sequence[Result], folder: Path) -> None:
    """The table as a file, and the picture."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "throughput.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(vars(results[0]))
        writer.writerows(vars(result).values() for result in results)
    figure, axes = plt.subplots(figsize=(8.0, 5.2), layout="constrained")
    markers = dict(zip(NAMES, "svx^o*PX", strict=True))
    labels = {
        "JAX": "JAX, vmap + scan",
        "plain JAX": "the same with jax.random.categorical",
        "NumPy": "NumPy, a loop",
        "eager": "update by update, in Trainer.fit",
        "blocks": "blocks of updates",
        "Trainer": "blocks of updates, in Trainer.fit",
        "projection": "projection rule with Adam, blocks, in Trainer.fit",
        "eager projection": "projection rule with Adam, update by update",
    }
    for name in NAMES:
        own = [result for result in results if result.name == name]
        sizes, rates = [r.agents for r in own], [r.median for r in own]
        axes.plot(sizes, rates, marker=markers[name], label=labels[name])
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({result.agents for result in results})
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_xlabel("agents R")
    axes.set_ylabel("agent-updates per second")
    axes.set_title("The paper's rule on predator-prey, one encounter per update")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(folder / "throughput.png", dpi=150)


def main() -> None:
    """Checks, measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 16, 256, 2048])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--device", type=torch.device, default=torch.device("cpu"))
    parser.add_argument("--output", type=Path, default=Path("throughput"))
    options = parser.parse_args()
    quieten()
    torch.set_num_threads(1)
    if options.device.type == "cpu" and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    rules = (JaxRule(), PlainJaxRule(), NumPyRule())
    check_gradients(rules[0], rules[2])
    results = []
    for size in options.sizes:
        results += measure(size, rules, options.device, options.repeats)
    print_table(results)
    write_results(results, options.output)


if __name__ == "__main__":
    main()
