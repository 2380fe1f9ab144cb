"""How often `bra.blahut_arimoto.serial` finds the optimum of hard problems, and which starts do.

    python benchmarks/serial_starts.py [problems] [family of seeds]

Problems: 8 to 30 states, 5 to 24 actions, 3 to 8 percepts, prices from 2 to 40 (log-uniform, each
by itself), priors from a Dirichlet distribution of concentration 0.5, 1 or 5, utilities in turn
uniform, normal, negative squared distances in the plane, and of rank three plus noise.

Beside it stands what one would write by hand: plain sweeps of the self-consistent equations in
NumPy, all of 200 random starts as one array, until no J rises by more than 1e-9 of the range of
utilities in 50 sweeps, or 3 000 sweeps. For each problem the shortfall of either below the better
of the two is counted, in units of the range; then, for each kind of start, the share of its starts
that end at the best.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import sys
import time
import warnings

import numpy as np
import torch
from numpy.typing import NDArray

from bra.blahut_arimoto import serial
from bra.blahut_arimoto.starts import KINDS

Array = NDArray[np.float64]
Problem = tuple[Array, Array, int, float, float]

STARTS, SWEEPS, CHECK = 200, 3000, 50
TINY = 1e-200
# Of the range of utilities: what counts as a shortfall.
MISSED = 1e-6


def problem(number: int, family: int = 2024) -> Problem:
    """Utilities, prior, percepts and prices."""
    rng = np.random.default_rng([family, number])
    states, actions = int(rng.integers(8, 31)), int(rng.integers(5, 25))
    percepts = int(rng.integers(3, 9))
    plane = rng.random((states, 1, 2)) - rng.random((1, actions, 2))
    low_rank = rng.standard_normal((states, 3)) @ rng.standard_normal((3, actions))
    utilities = (
        rng.random((states, actions)),
        rng.standard_normal((states, actions)),
        -3 * np.square(plane).sum(-1),
        low_rank / 1.5 + 0.3 * rng.standard_normal((states, actions)),
    )[number % 4]
    prior = rng.dirichlet(np.full(states, rng.choice([0.5, 1.0, 5.0])))
    beta_1, beta_2 = np.exp(rng.uniform(np.log(2), np.log(40), 2))
    return utilities, prior, percepts, float(beta_1), float(beta_2)


def by_hand(case: Problem, seed: int) -> float:
    """The best J of plain Blahut-Arimoto from random starts."""
    utilities, prior, percepts, beta_1, beta_2 = case
    rng = np.random.default_rng(seed)
    action = rng.dirichlet(0.3 * np.ones(utilities.shape[1]), size=(STARTS, percepts))
    percept = np.full((STARTS, 1, percepts), 1 / percepts)
    marginal = percept @ action
    before = np.full(STARTS, -np.inf)
    for sweep in range(SWEEPS):
        log_ratio = np.log(np.maximum(action, TINY)) - np.log(np.maximum(marginal, TINY))
        cost = (action * log_ratio).sum(2) / beta_2
        logits = np.log(percept) + beta_1 * (utilities @ action.mT - cost[:, None])
        highest = logits.max(2, keepdims=True)
        perception = np.exp(logits - highest)
        partition = perception.sum(2, keepdims=True)
        perception /= partition
        objective = (highest + np.log(partition))[..., 0] @ prior / beta_1
        if sweep % CHECK == 0:
            if (objective - before).max() < 1e-9 * np.ptp(utilities):
                break
            before = objective
        joint = prior[:, None] * perception
        percept = np.maximum(joint.sum(1), TINY)[:, None]
        worth = joint.mT @ utilities / percept.mT
        action = np.maximum(marginal, TINY) * np.exp(beta_2 * (worth - worth.max(2, keepdims=True)))
        action /= action.sum(2, keepdims=True)
        marginal = percept @ action
    return float(objective.max())


def main() -> None:
    """Prints a line for each problem that either misses, and the counts."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    given = [int(word) for word in sys.argv[1:]]
    count, family = given + [200, 2024][len(given) :]
    shortfalls, starts, seconds = [], [], np.zeros(2)
    ended = np.zeros((count, len(KINDS)))
    for number in range(count):
        case = problem(number, family)
        begin = time.perf_counter()
        ours = serial(*case)
        middle = time.perf_counter()
        theirs = by_hand(case, number)
        seconds += middle - begin, time.perf_counter() - middle
        spread = float(np.ptp(case[0]))
        best = max(float(ours.objective), theirs)
        short = np.array([best - float(ours.objective), best - theirs]) / spread
        shortfalls.append(short)
        starts.append(ours.starts)
        hit = np.asarray(ours.optima)[1:32] >= best - MISSED * spread
        ended[number] = [hit[kind :: len(KINDS)].mean() for kind in range(len(KINDS))]
        if short.max() > MISSED:
            print(f"{number:>4} bra -{short[0]:.1e}, by hand -{short[1]:.1e}", flush=True)
    missed = (np.array(shortfalls) > MISSED).sum(0)
    print(f"{count} problems; below the other's best: bra {missed[0]}, by hand {missed[1]}")
    print(
        f"starts {np.mean(starts):.0f} on average, {(np.array(starts) > 32).mean():.0%} need more"
    )
    print(f"seconds a problem: bra {seconds[0] / count:.2f}, by hand {seconds[1] / count:.2f}")
    for kind, share, never in zip(KINDS, ended.mean(0), (ended == 0).mean(0), strict=True):
        print(f"{kind:<13} ends at the best {share:.0%}; never, in the first batch, {never:.0%}")


if __name__ == "__main__":
    main()
