"""What the paper's on-line rule reaches, beside the optimum.

    python benchmarks/paper_rule.py [--config configs/predator_prey_online.yaml] [--seeds 8]
        [--jobs 2] [--updates 100000]

Trains the agent of a configuration (one encounter per update, plain gradient ascent, the paper's
network, sensor, rates and prices) once per seed and prints what came out as a Markdown table. To
save Lightning's share of each update, the loop below stands in for the trainer; random numbers are
counted, so it must do, and is checked to do, exactly what `bra fit` does.
"""

import argparse
import functools
import multiprocessing
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from bra import Agent
from bra.callbacks.baseline import solve_optimum
from bra.cli import BraCLI, quieten
from bra.objective import Objective, bits
from bra.tasks.datamodule import WorldStream

CONFIG = Path(__file__).parents[1] / "configs" / "predator_prey_online.yaml"


def build(config: str | Path, seed: int, updates: int, overrides: Sequence[str] = ()) -> Agent:
    """The agent of a configuration, trained by Lightning for some updates."""
    with tempfile.TemporaryDirectory() as folder:
        off = [
            f"--{name}=null"
            for name in ("information", "baseline", "behaviour", "summary", "frames")
        ]
        quiet = ["logger", "enable_checkpointing", "enable_progress_bar"]
        return BraCLI(
            [
                *("fit", f"--config={config}", f"--seed_everything={seed}"),
                *(f"--trainer.max_steps={updates}", "--trainer.limit_val_batches=0", *off),
                *(f"--trainer.{key}=false" for key in quiet),
                f"--trainer.default_root_dir={folder}",
                *overrides,
            ]
        ).model


def train(agent: Agent, updates: int) -> None:
    """The updates of `Agent.training_step`, without the trainer."""
    worlds = WorldStream(agent.task, 1, agent.seed, "world")
    optimizers, _ = agent.configure_optimizers()
    for update in range(updates):
        loss = agent.update_loss(worlds[update])
        for optimizer in optimizers:
            optimizer.zero_grad()
        loss.backward()
        for optimizer in optimizers:
            optimizer.step()
        agent.updates += 1


def check(config: str, updates: int = 200) -> None:
    """Both loops end with the same weights, bit by bit."""
    ours, lightning = build(config, 0, 0), build(config, 0, updates)
    train(ours, updates)
    for one, other in zip(ours.parameters(), lightning.parameters(), strict=True):
        assert torch.equal(one, other)


def run(seed: int, config: str, updates: int) -> tuple[int, Objective[float]]:
    """One seed's end."""
    torch.set_num_threads(1)
    quieten()
    agent = build(config, seed, 0)
    train(agent, updates)
    return seed, agent.evaluate()


def main() -> None:
    """Runs all seeds and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", default=str(CONFIG))
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--updates", type=int, default=100_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    quieten()
    check(options.config)

    print("| seed | J | E[U] | I(Ω;X) bits | I(X;A) bits |")
    print("|---|---|---|---|---|", flush=True)
    reached = []
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        train_seed = functools.partial(run, config=options.config, updates=options.updates)
        for seed, end in pool.imap(train_seed, range(options.seeds)):
            reached.append(end.objective)
            print(
                f"| {seed} | {end.objective:.3f} | {end.expected_utility:.3f} "
                f"| {bits(end.perception_information):.2f} | {bits(end.action_information):.2f} |",
                flush=True,
            )
    optimum = solve_optimum(build(options.config, 0, 0)).objective
    hits = sum(optimum - objective < 0.005 for objective in reached)
    print(
        f"\nJ: median {statistics.median(reached):.3f}, from {min(reached):.3f} to "
        f"{max(reached):.3f}; optimum {optimum:.5f}; {hits} of {len(reached)} within 0.005 of it"
    )


if __name__ == "__main__":
    main()
