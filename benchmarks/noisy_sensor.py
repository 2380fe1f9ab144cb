"""How near agents come to what a noisy sensor allows, where p(ω|ξ) is learnt beside the channels.

    python benchmarks/noisy_sensor.py [--seeds 4] [--seed 0] [--updates 4000]

States 0 to 3 with prior 0.4, 0.3, 0.2, 0.1, seen at their number with normal noise of σ = 0.7;
naming the state is worth 1. Of agents of which nothing is said but percepts and prices, J over
2¹⁷ signals of each state is held against the optimum that the sensor allows. Prints a table.
"""

import argparse
import math
import tempfile

import lightning.pytorch as pl
import torch
from gymnasium.spaces import Box, Discrete

from bra import FiniteTask, Population, RolloutDataModule, World
from bra.evaluation.references import solve_references

PRICES = [(8.0, 8.0), (20.0, 20.0)]
SIGNALS = 2**17


class Cue(FiniteTask):
    """State i is seen at i, with normal noise."""

    def __init__(self) -> None:
        space = Box(-math.inf, math.inf, (1,))
        super().__init__(torch.eye(4), [0.4, 0.3, 0.2, 0.1], observations=space)

    def observe(self, state: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """ξ = ω + 0.7 ε."""
        return state.unsqueeze(-1) + 0.7 * torch.randn((len(state), 1), generator=generator)


def judge(prices: tuple[float, float], task: Cue, options: argparse.Namespace) -> list[float]:
    """J of agents of successive seeds, all on the same signals."""
    agents = Population(task, options.seeds, False, "auto", *prices, seed=options.seed, percepts=4)
    trainer = pl.Trainer(
        max_epochs=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        default_root_dir=tempfile.mkdtemp(),
    )
    trainer.fit(agents, RolloutDataModule(task, updates_per_epoch=options.updates))
    state = torch.arange(4).repeat_interleave(SIGNALS)
    world = World(state, task.observe(state, torch.Generator().manual_seed(options.seed)))
    found = [agents.member(index).evaluation(world) for index in range(len(agents))]
    errors = [e.standard_error.objective for e in found if e.standard_error]
    print(f"standard error of J: {max(errors):.5f}")
    return [evaluation.objective.objective for evaluation in found]


def main() -> None:
    """Trains at each pair of prices."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--updates", type=int, default=4000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    task = Cue()
    references = solve_references(task, Discrete(4), PRICES, seed=options.seed)
    rows = []
    for prices, reference in references.items():
        reached = judge(prices, task, options)
        best = f"{reference.objective:.4f} ± {reference.error:.4f}"
        rows.append(
            f"| {prices[0]:g} | {best} | {min(reached):.4f} to {max(reached):.4f} | 0.4000 |"
        )
    print("\n| β₁ = β₂ | optimum | J of the agents | no information |\n|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
