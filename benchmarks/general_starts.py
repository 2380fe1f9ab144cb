"""How often `bra.blahut_arimoto.general` finds the optimum of hard problems, and which starts do.

    python benchmarks/general_starts.py [problems] [family of seeds]

First come the medical tables of Genewein et al. (2015) with both priors at four sets of prices
each, predator-prey and the taxonomy at three; then random problems. Their utilities, priors,
percepts and first two prices are those of `serial_starts.py`; the third price is from a fifth to
nine tenths of 1/(1/β₁ + 1/β₂), from where percepts are worthless. Takes about a quarter of an hour.

Beside it stands what one would write by hand: plain sweeps of the self-consistent equations in
NumPy, all of 200 random starts as one array, until no J rises by more than 1e-9 of the range of
utilities in 50 sweeps, or 3 000 sweeps. For each problem the shortfall of either below the better
of the two is counted, in units of the range; then, for each kind of start, the share of its starts
that end at the best.
"""

import math
import sys
import time
import warnings

import numpy as np
import serial_starts  # sets the number of threads of NumPy
import torch
from numpy.typing import NDArray

from bra.blahut_arimoto import general
from bra.blahut_arimoto.starts import KINDS
from bra.tasks import FiniteTask, Medical, PredatorPrey, Taxonomy

Array = NDArray[np.float64]
Problem = tuple[Array, Array, int, float, float, float]

STARTS, SWEEPS, CHECK = serial_starts.STARTS, serial_starts.SWEEPS, serial_starts.CHECK
TINY, MISSED = serial_starts.TINY, serial_starts.MISSED
MEDICAL = ((1, math.inf, 0.9), (2.5, math.inf, 1), (10, 5, 2), (8, 10, 3))
OTHERS = ((8, 10, 3), (8, 10, 1), (2, 8, 0.5))


def published() -> list[tuple[str, Problem]]:
    """The tables of Genewein et al. (2015), by name."""
    tables: list[tuple[str, FiniteTask, int, tuple[tuple[float, float, float], ...]]] = [
        ("medical, uniform", Medical("uniform"), 3, MEDICAL),
        ("medical, heart-heavy", Medical("heart-heavy"), 3, MEDICAL),
        ("predator-prey", PredatorPrey(), 13, OTHERS),
        ("taxonomy", Taxonomy(), 4, OTHERS),
        ("taxonomy", Taxonomy(), 13, OTHERS),
    ]
    return [
        (f"{name}, |X| = {percepts}", (*_arrays(task), percepts, *betas))
        for name, task, percepts, prices in tables
        for betas in prices
    ]


def _arrays(task: FiniteTask) -> tuple[Array, Array]:
    return task.utilities.numpy(), task.prior.numpy()


def problem(number: int, family: int) -> Problem:
    """Utilities, prior, percepts and prices of a random problem."""
    utilities, prior, percepts, beta_1, beta_2 = serial_starts.problem(number, family)
    share = np.random.default_rng([family + 1, number]).uniform(0.2, 0.9)
    return utilities, prior, percepts, beta_1, beta_2, share / (1 / beta_1 + 1 / beta_2)


def by_hand(case: Problem, seed: int) -> float:
    """The best J of plain sweeps from random starts."""
    utilities, prior, percepts, beta_1, beta_2, beta_3 = case
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(0.3 * np.ones(utilities.shape[1]), (STARTS, percepts)) + 1e-12
    percept = np.full((STARTS, percepts), 1 / percepts)
    kernel = np.exp(beta_3 * (utilities - utilities.max(1, keepdims=True)))
    offset = prior @ utilities.max(1)
    before = np.full(STARTS, -np.inf)
    for sweep in range(SWEEPS):
        marginal = np.einsum("nx,nxa->na", percept, rows)
        tilted = rows * np.exp(-beta_3 / beta_2 * (np.log(rows) - np.log(marginal)[:, None]))
        partition = tilted @ kernel.T  # (n, X, W)
        logits = np.log(percept)[:, :, None] + beta_1 / beta_3 * np.log(partition)
        highest = logits.max(1, keepdims=True)
        perception = np.exp(logits - highest)
        total = perception.sum(1, keepdims=True)
        perception /= total
        objective = (highest + np.log(total))[:, 0] @ prior / beta_1 + offset
        if sweep % CHECK == 0:
            if (objective - before).max() < 1e-9 * np.ptp(utilities):
                break
            before = objective
        joint = perception * prior
        percept = np.maximum(joint.sum(2), TINY)
        rows = np.maximum(tilted * (joint / partition @ kernel) / percept[..., None], TINY)
    return float(objective.max())


def main() -> None:
    """Prints a line for each problem as it is solved, and the counts."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    given = [int(word) for word in sys.argv[1:]]
    count, family = given + [30, 2024][len(given) :]
    cases = published() + [(f"random {n}", problem(n, family)) for n in range(count)]
    shortfalls, hits, seconds = [], [], np.zeros(2)
    for number, (name, case) in enumerate(cases):
        begin = time.perf_counter()
        ours = general(*case)
        middle = time.perf_counter()
        theirs = by_hand(case, number)
        seconds += middle - begin, time.perf_counter() - middle
        spread = float(np.ptp(case[0]))
        best = max(float(ours.objective), theirs)
        short = np.array([best - float(ours.objective), best - theirs]) / spread
        shortfalls.append(short)
        hit = np.asarray(ours.optima)[1:32] >= best - MISSED * spread
        hits.append([hit[kind :: len(KINDS)].mean() for kind in range(len(KINDS))])
        betas = ", ".join(f"{beta:.3g}" for beta in case[3:])
        print(
            f"{name}, β ({betas}): J {best:.5f}, short bra {short[0]:.1e}, by hand {short[1]:.1e}; "
            f"{hit.mean():.0%} of the first starts; {int(ours.starts)} starts",
            flush=True,
        )
    missed = (np.array(shortfalls) > MISSED).sum(0)
    total = len(cases)
    print(f"{total} problems; below the other's best: bra {missed[0]}, by hand {missed[1]}")
    print(f"seconds a problem: bra {seconds[0] / total:.2f}, by hand {seconds[1] / total:.2f}")
    ended = np.array(hits)
    for kind, share, never in zip(KINDS, ended.mean(0), (ended == 0).mean(0), strict=True):
        print(f"{kind:<13} ends at the best {share:.0%}; never, in the first batch, {never:.0%}")


if __name__ == "__main__":
    main()
