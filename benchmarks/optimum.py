"""How often agents reach the optimum of predator-prey, at five pairs of prices.

    python benchmarks/optimum.py [--config predator_prey.yaml] [--seeds 16] [--jobs 2] [--KEY VALUE]

Trains the agent of a configuration once per seed and pair of prices, with the loop of
`paper_rule.py`, and prints how many end within 0.005 of the best known optimum as a Markdown table.
Other keys are those of the command, such as `--model.cooling=null`.
"""

import argparse
import itertools
import multiprocessing
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from paper_rule import build, train

from bra.callbacks.baseline import solve_optimum
from bra.cli import quieten

CONFIGS = Path(__file__).parents[1] / "configs"
PRICES = ((8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0), (0.5, 0.5))
UPDATES = {"predator_prey.yaml": 2000, "predator_prey_critic.yaml": 3000}


def run(
    job: tuple[tuple[float, float], int], config: str, overrides: Sequence[str]
) -> tuple[float, float]:
    """J of one seed's end, and by how much it falls short of the optimum."""
    (beta_1, beta_2), seed = job
    torch.set_num_threads(1)
    quieten()
    betas = [f"--model.beta_perception={beta_1}", f"--model.beta_action={beta_2}"]
    agent = build(CONFIGS / config, seed, 0, [*overrides, *betas])
    train(agent, UPDATES[config])
    reached = agent.evaluate().objective
    return reached, float(solve_optimum(agent).objective) - reached


def main() -> None:
    """Runs all seeds and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", choices=UPDATES, default="predator_prey.yaml")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--jobs", type=int, default=2)
    options, overrides = parser.parse_known_args()
    print("| β₁, β₂ | within 0.005 | mean J | largest gap |")
    print("|---|---|---|---|", flush=True)
    jobs = list(itertools.product(PRICES, range(options.seeds)))
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        train_one = partial(run, config=options.config, overrides=overrides)
        ends = pool.imap(train_one, jobs)
        for (beta_1, beta_2), group in itertools.groupby(
            zip(jobs, ends, strict=True), lambda pair: pair[0][0]
        ):
            objectives, gaps = zip(*(end for _, end in group), strict=True)
            hits = sum(gap < 0.005 for gap in gaps)
            mean = sum(objectives) / len(objectives)
            print(
                f"| {beta_1:g}, {beta_2:g} | {hits} of {len(gaps)} | {mean:.5f} "
                f"| {max(gaps):.5f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
