"""What the paper's on-line rule reaches on predator-prey, beside the optimum.

    python benchmarks/paper_rule.py [--seeds 8] [--jobs 2] [--updates 100000]

Runs `configs/predator_prey_online.yaml` (one encounter per update, plain gradient ascent, the
paper's network, sensor, rates and prices) once per seed through the command `bra`, and prints what
came out as a Markdown table. A run of 100 000 updates takes some minutes.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

CONFIG = Path(__file__).parents[1] / "configs" / "predator_prey_online.yaml"


def run(seed: int, updates: int) -> dict[str, Any]:
    """One run; its summary."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(sys.executable, "-c", "from bra.cli import main; main()", "fit"),
            f"--config={CONFIG}",
            f"--seed_everything={seed}",
            f"--data.updates_per_epoch={updates // 10}",
            f"--trainer.default_root_dir={folder}",
            "--trainer.enable_progress_bar=false",
            "--behaviour=null",
        ]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (path,) = Path(folder).rglob("summary.json")
        return json.loads(path.read_text())


def main() -> None:
    """Runs all seeds and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--updates", type=int, default=100_000)
    options = parser.parse_args()

    print("| seed | J | E[U] | I(Ω;X) nats | I(X;A) nats | gap to the optimum | minutes |")
    print("|---|---|---|---|---|---|---|", flush=True)
    summaries = []
    with ThreadPoolExecutor(options.jobs) as pool:
        for summary in pool.map(lambda seed: run(seed, options.updates), range(options.seeds)):
            summaries.append(summary)
            print(
                f"| {summary['seed']} | {summary['objective']:.3f} "
                f"| {summary['expected_utility']:.3f} "
                f"| {summary['perception_information_nats']:.3f} "
                f"| {summary['action_information_nats']:.3f} "
                f"| {summary['gap']:.3f} | {summary['seconds'] / 60:.1f} |",
                flush=True,
            )
    reached = [summary["objective"] for summary in summaries]
    optimum = summaries[0]["blahut_arimoto_objective"]
    hits = sum(optimum - objective < 0.005 for objective in reached)
    print(
        f"\nJ: median {statistics.median(reached):.3f}, from {min(reached):.3f} to "
        f"{max(reached):.3f}; optimum {optimum:.5f}; {hits} of {len(reached)} within 0.005 of it"
    )


if __name__ == "__main__":
    main()
