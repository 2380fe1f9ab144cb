"""What `serial(..., certify=SECONDS)` leaves as a gap, on one core.

    python benchmarks/certificate.py [SECONDS]

Prints a table: J of the best optimum found, the gap that the bound leaves without and with branch
and bound, boxes, and seconds of the processor that it took.
"""

import json
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from bra.blahut_arimoto import serial
from bra.tasks import PredatorPrey

TABLE = Path(__file__).parent.parent / "tests" / "update_rules" / "table13x8.csv"

Problem = tuple[np.ndarray, np.ndarray | None, int, float, float]


def problems() -> Iterator[tuple[str, Problem]]:
    """Predator-prey at five pairs of prices, a table whose best starts are rare, random tables."""
    hunting = PredatorPrey().utilities.numpy()
    for betas in ((1.0, 1.0), (1.0, 10.0), (8.0, 1.0), (0.5, 0.5), (8.0, 10.0)):
        yield f"predator-prey {betas}", (hunting, None, 13, *betas)
    told = json.loads((TABLE.with_suffix(".json")).read_text(encoding="utf-8"))
    rows = np.loadtxt(TABLE, delimiter=",", skiprows=1, usecols=range(1, 9))
    betas = told["beta_perception"], told["beta_action"]
    yield "table13x8", (rows, np.array(told["prior"]), told["percepts"], *betas)
    for states, actions, seed in ((20, 3, 0), (8, 6, 1), (12, 6, 2), (10, 10, 3), (13, 8, 2)):
        rng = np.random.default_rng(seed)
        utilities, prior = 2 * rng.normal(size=(states, actions)), rng.dirichlet([2] * states)
        betas = np.exp(rng.uniform(np.log(0.5), np.log(8), 2))
        yield f"random {states} x {actions}", (utilities, prior, states, *betas.tolist())


def processor() -> str:
    """Its name, as the system tells it."""
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()


def main() -> None:
    """Prints the table."""
    torch.set_num_threads(1)
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    print(f"{processor()}, one core, {seconds:g} s\n")
    print("| problem | J | gap before | gap | boxes | seconds | closed |")
    print("|---|---|---|---|---|---|---|")
    for name, problem in problems():
        began = time.process_time()
        plain = serial(*problem)
        solved = time.process_time()
        found = serial(*problem, certify=seconds)
        spent = time.process_time() - solved - (solved - began)
        print(
            f"| {name} | {found.objective:.5f} | {plain.bound - plain.objective:.5f} "
            f"| {found.bound - found.objective:.5f} | {found.nodes} | {max(spent, 0):.1f} "
            f"| {'yes' if found.closed else 'no'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
