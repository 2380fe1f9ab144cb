"""`bra frontier`: what information earns along prices, as a table and as a figure."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from gymnasium.spaces import Discrete

from bra.agent.agent import Agent
from bra.agent.learner import Learner
from bra.agent.run_folder import run_folder
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.checks.words import amount
from bra.cli.errors import fail
from bra.frontiers import Frontier, frontier
from bra.frontiers.frontier import tidy_rows
from bra.frontiers.picture import CHANNELS, draw_frontier
from bra.population import Population
from bra.tasks import FiniteTask, RolloutDataModule


def run_frontier(
    trainer: pl.Trainer,
    model: Learner,
    datamodule: RolloutDataModule | None,
    points: int,
    grid: bool,
    agents: bool,
) -> None:
    """Solves, trains if agents are wanted, writes the files and says what they hold."""
    if not isinstance(model, Agent):
        fail("frontier scales one pair of prices, got a population; give one beta of each kind")
    if model.budgets:
        fail("frontier scales one pair of prices, got budgets; give one beta of each kind")
    if not (isinstance(model.task, FiniteTask) and isinstance(model.percept_space, Discrete)):
        fail(
            "frontier needs a task with a table of utilities and Discrete percepts, got "
            f"{type(model.task).__name__} and {model.percept_space}"
        )
    if agents and model.beta_direct is not None:
        fail("frontier trains agents of two prices, got beta_direct; leave --agents out")
    percepts = int(model.percept_space.n)
    prices = model.beta_perception, model.beta_action
    restarts = (baseline_of(trainer) or BaselineMonitor()).restarts
    try:
        found = frontier(
            *(model.task, *prices, percepts, points, grid, restarts, model.seed),
            beta_direct=model.beta_direct,
        )
    except ValueError as error:
        fail(str(error))
    rows, terms = found.rows(), None
    if agents:
        population = train_agents(trainer, model, datamodule, found)
        terms = agent_columns(population)
        rows += tidy_rows("agent", terms)
    folder = run_folder(trainer)
    table = folder.file("frontier.csv")
    write_rows(rows, table)
    figure = draw_frontier(found, terms)
    pictures = [folder.file(f"frontier.{kind}") for kind in ("png", "pdf")]
    for picture in pictures:
        figure.savefig(picture, dpi=200)
    print(frontier_text(found))
    if not model.task.noiseless:
        print("note: optima and bounds without sensor noise; with it, less can be earned")
    print(f"written to {', '.join(str(path) for path in (table, *pictures))}")


def train_agents(
    trainer: pl.Trainer, model: Agent, datamodule: RolloutDataModule | None, found: Frontier
) -> Population:
    """A population of one agent at each of the prices, trained."""
    own = model.init_arguments() | {
        "replicas": 1,
        "beta_perception": found.beta_perception.tolist(),
        "beta_action": found.beta_action.tolist(),
        "seed": model.seed,
    }
    population = Population(**own)
    trainer.fit(population, datamodule)
    return population


def agent_columns(population: Population) -> dict[str, Any]:
    """Prices and terms of all agents, by the names that optima have."""
    terms = population.evaluate_members()
    prices = ("beta_perception", "beta_action")
    columns = {name: [getattr(s, name) for s in population.settings] for name in prices}
    return columns | {
        name: value
        for name in ("objective", "expected_utility", *CHANNELS)
        if (value := getattr(terms, name)) is not None
    }


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Writes a table with a header; what a row does not have stays empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


def frontier_text(found: Frontier) -> str:
    """Where behaviour changes, for people."""
    changes = [
        f"β₁ {beta_1:<9.4g} β₂ {beta_2:<9.4g} {text}"
        for beta_1, beta_2, text in zip(
            found.beta_perception.tolist(), found.beta_action.tolist(), found.change, strict=True
        )
        if text
    ]
    optima = amount(len(found.change), "optimum", "optima")
    head = f"{optima}, best of many starts, with certified bounds"
    return "\n".join([head, *changes])
