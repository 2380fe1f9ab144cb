"""How often agents whose actions look at the state again reach the optimum, from many seeds.

    python benchmarks/specialists.py [seeds] [first seed] [random tables]

The medical tables of Genewein et al. (2015) with both priors at four sets of prices, and their
taxonomy at two, by the agent of `configs/medical.yaml`; predator-prey at three, by what is chosen
where nothing is said. Or so many random tables, by the same: 4 to 10 states, 3 to 8 actions, even
and skewed priors, β₁ and β₂ from 0.5 to 10 or β₂ = inf, β₃ from a tenth of 1/(1/β₁ + 1/β₂), from
where percepts are worthless; as many percepts as states, or 2 to 4.

A hit ends within 0.005 times the range of utilities of the best optimum that
`bra.blahut_arimoto.general` finds. Prints a line for each task and set of prices; with it how often
the best of 16 seeds hits. Takes hours with 64 seeds.
"""

import logging
import math
import statistics
import sys
import tempfile
import warnings
from functools import partial
from typing import Any

import lightning.pytorch as pl
import numpy as np
import torch
from torch.optim import Adam

from bra import Population, RolloutDataModule
from bra.blahut_arimoto import general
from bra.channels import MLP, Multinomial
from bra.tasks import FiniteTask, Medical, PredatorPrey, TableTask, Taxonomy
from bra.update_rules import Projection, Rivals

HIT, UPDATES = 0.005, 2000
MEDICAL = ((1, math.inf, 0.9), (2.5, math.inf, 1), (10, 5, 2), (8, 10, 3))
PREDATOR_PREY = ((8, 10, 3), (8, 10, 1), (2, 8, 0.5))
TAXONOMY = ((8, 10, 3), (8, 10, 1.5))
CONFIG = {
    "percepts": 3,
    "perception": partial(MLP, hidden=[64]),
    "action": partial(Multinomial, start="covering"),
    "update_rule": Projection(rivals=Rivals()),
    "perception_optimizer": partial(Adam, lr=0.05),
    "action_optimizer": partial(Adam, lr=0.3),
}
QUIET = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")

Case = tuple[str, FiniteTask, tuple[float, float, float], dict[str, Any]]


def cases() -> list[Case]:
    """Name, task, prices and other settings."""
    found: list[Case] = [
        (f"medical, {prior}", Medical(prior, "index"), prices, CONFIG)
        for prior in ("uniform", "heart-heavy")
        for prices in MEDICAL
    ]
    four = CONFIG | {"percepts": 4}
    found += [("taxonomy, |X| = 4", Taxonomy("index"), prices, four) for prices in TAXONOMY]
    found += [("predator-prey", PredatorPrey(), p, {"percepts": 13}) for p in PREDATOR_PREY]
    return found


def random_case(number: int) -> Case:
    """A random table."""
    rng = np.random.default_rng([77, number])
    states, actions = int(rng.integers(4, 11)), int(rng.integers(3, 9))
    shape = states, actions
    utilities = (rng.uniform(0, 3, shape), rng.standard_normal(shape), 3 * rng.random(shape) ** 3)
    prior = np.maximum(rng.dirichlet(np.full(states, rng.choice([0.5, 1, 5.0]))), 1e-3)
    beta_1, beta_2 = np.exp(rng.uniform(np.log(0.5), np.log(10), 2)).tolist()
    if rng.random() < 0.2:
        beta_2 = math.inf
    beta_3 = rng.uniform(0.1, 0.95) / (1 / beta_1 + 1 / beta_2)
    percepts = int(rng.integers(2, 5)) if rng.random() < 0.5 else states
    code = ("onehot", "index", "binary")[int(rng.integers(3))]
    table = utilities[number % 3].tolist()
    task = TableTask(table, (prior / prior.sum()).tolist(), observations=code)
    prices = beta_1, beta_2, float(beta_3)
    return f"random {number}", task, prices, {"percepts": percepts}


def trained(
    task: FiniteTask, betas: dict[str, float], own: dict[str, Any], seeds: int, first: int
) -> list[float]:
    """J of agents of so many seeds at the end of their run, in one go."""
    agents = Population(task, replicas=seeds, **own, **betas, seed=first)
    with tempfile.TemporaryDirectory() as folder:
        trainer = pl.Trainer(max_epochs=1, default_root_dir=folder, **dict.fromkeys(QUIET, False))
        trainer.fit(agents, RolloutDataModule(task, 1, UPDATES))
    found: list[float] = agents.objectives().tolist()
    return found


def main() -> None:
    """Prints the hits of every case."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    given = [int(word) for word in sys.argv[1:]]
    seeds, first, tables = given + [64, 0, 0][len(given) :]
    for name, task, prices, own in map(random_case, range(tables)) if tables else cases():
        betas = dict(zip(("beta_perception", "beta_action", "beta_direct"), prices, strict=True))
        best = float(general(task.utilities, task.prior, own["percepts"], *prices).objective)
        short = [best - found for found in trained(task, betas, own, seeds, first)]
        hits = sum(gap <= HIT * task.utility_range for gap in short)
        blocks = [min(short[n : n + 16]) for n in range(0, seeds, 16)]
        hit_blocks = sum(gap <= HIT * task.utility_range for gap in blocks)
        print(
            f"{name:<20} β {prices}: {hits} of {seeds} hit {best:.5f}, "
            f"{hit_blocks} of {len(blocks)} populations of 16; "
            f"median shortfall {statistics.median(short):.5f}, worst {max(short):.5f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
