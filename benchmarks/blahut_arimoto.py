"""Time of `bra.blahut_arimoto.serial` against the same equations as a NumPy loop.

    python benchmarks/blahut_arimoto.py

Both use one core, start from the same kinds of point and stop on the same certificate at the same
tolerance. The loop does what one would write by hand: one restart after another, one pair of
prices after another, no extrapolation. The time of `bra` includes its upper bound; what the bound
costs by plain one-channel Blahut-Arimoto is shown beside the loop. The two run in turn, and
medians are compared.
"""

import os

# One core each, so that the ratio speaks of the algorithm. BLAS reads this when it is loaded.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from bra.blahut_arimoto import CLIMB_TOLERANCE, GAP_TOLERANCE, SWEEP_CAP, serial

Array = NDArray[np.float64]

PREDATOR_PREY = np.array(
    [
        [3.5, 2.4, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
        [2.4, 3.5, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
        [2.4, 2.4, 3.5, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5],
        [1.5, 1.5, 1.5, 2.3, 1.84, 1.84, 2.3, 1.5, 0.5],
        [1.5, 1.5, 1.5, 1.84, 2.3, 1.84, 2.3, 1.5, 0.5],
        [1.5, 1.5, 1.5, 1.84, 1.84, 2.3, 2.3, 1.5, 0.5],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0],
    ]
)
"""Utilities of Genewein et al. (2015), section 4: nine animals, nine actions."""


@dataclass(frozen=True)
class Case:
    """One problem, solved for every pair of the given prices."""

    name: str
    utilities: Array
    percepts: int
    beta_perception: Array
    beta_action: Array
    restarts: int
    rounds: int


def cases() -> list[Case]:
    """The three problems: one cell, a grid of prices, a large table."""
    prices = np.geomspace(0.5, 20.0, 20)
    grid_1, grid_2 = np.meshgrid(prices, prices, indexing="ij")
    table = np.random.default_rng(0).random((300, 300))
    return [
        Case(
            "predator-prey (8,10), |X| = 13, 32 restarts",
            PREDATOR_PREY,
            13,
            np.array([8.0]),
            np.array([10.0]),
            32,
            9,
        ),
        Case(
            "predator-prey 20×20 prices, |X| = 13, 8 restarts",
            PREDATOR_PREY,
            13,
            grid_1.ravel(),
            grid_2.ravel(),
            8,
            3,
        ),
        Case(
            "random 300×300 (10,10), |X| = 300, 1 restart",
            table,
            300,
            np.array([10.0]),
            np.array([10.0]),
            1,
            3,
        ),
    ]


def climb(utilities: Array, action: Array, beta_1: float, beta_2: float) -> tuple[float, int]:
    """Blahut-Arimoto from the channel p(a|x); returns J and the number of sweeps."""
    prior = np.full(len(utilities), 1 / len(utilities))
    percept = np.full(len(action), 1 / len(action))
    marginal = percept @ action
    tolerance = CLIMB_TOLERANCE * np.ptp(utilities) + 16 * np.finfo(float).eps * (
        1 / beta_1 + 1 / beta_2
    )
    gain_2 = np.inf
    sweeps = 0
    while sweeps < SWEEP_CAP:
        sweeps += 1
        cost = (action * np.log(np.maximum(action, 1e-300) / marginal)).sum(1)
        logits = beta_1 * (utilities @ action.T - cost / beta_2)
        logits -= logits.max(1, keepdims=True)
        weights = np.exp(logits) * percept
        perception = weights / weights.sum(1, keepdims=True)
        joint = prior[:, None] * perception
        renewed = np.maximum(joint.sum(0), 1e-200)
        gain_1 = np.log((renewed / percept).max()) / beta_1
        if gain_1 + gain_2 <= tolerance:
            break
        percept = renewed
        logits = beta_2 * (joint.T @ utilities) / percept[:, None]
        logits -= logits.max(1, keepdims=True)
        weights = np.exp(logits) * marginal
        action = weights / weights.sum(1, keepdims=True)
        renewed = np.maximum(percept @ action, 1e-200)
        gain_2 = np.log((renewed / marginal).max()) / beta_2
        marginal = renewed
    return objective(utilities, perception, action, beta_1, beta_2), sweeps


def upper_bound(utilities: Array, beta: float) -> float:
    """One-channel optimum plus its certified gap, by plain Blahut-Arimoto."""
    best = utilities.max(1, keepdims=True)
    kernel = np.exp(beta * (utilities - best))
    action = np.full(utilities.shape[1], 1 / utilities.shape[1])
    for _ in range(SWEEP_CAP):
        partition = kernel @ action
        growth = (1 / partition) @ kernel / len(utilities)
        if np.log(growth.max()) / beta <= GAP_TOLERANCE * np.ptp(utilities):
            break
        action = action * growth
    return float(best.mean() + np.log(partition).mean() / beta + np.log(growth.max()) / beta)


def objective(
    utilities: Array, perception: Array, action: Array, beta_1: float, beta_2: float
) -> float:
    """J = E[U] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) of two channels."""
    prior = np.full(len(utilities), 1 / len(utilities))
    percept = prior @ perception
    expected_utility = prior @ (perception @ action * utilities).sum(1)
    return float(
        expected_utility
        - information(prior, perception) / beta_1
        - information(percept, action) / beta_2
    )


def information(prior: Array, conditional: Array) -> float:
    """Mutual information in nats."""
    ratio = conditional / np.maximum(prior @ conditional, 1e-300)
    return float(prior @ (conditional * np.log(np.maximum(ratio, 1e-300))).sum(1))


def numpy_loop(case: Case) -> tuple[Array, int]:
    """Best J for each pair of prices, and the number of sweeps in all."""
    rng = np.random.default_rng(0)
    states, actions = case.utilities.shape
    best, total = [], 0
    for beta_1, beta_2 in zip(case.beta_perception, case.beta_action, strict=True):
        reached = []
        for restart in range(case.restarts):
            if restart % 2:
                favourite = rng.permutation(max(actions, case.percepts))[: case.percepts] % actions
                logits = 5.0 * np.eye(actions)[favourite]
            elif restart:
                noise = 10 * rng.random() * rng.standard_normal((states, case.percepts))
                perception = np.exp(noise - noise.max(1, keepdims=True))
                perception /= perception.sum(1, keepdims=True)
                logits = beta_2 * (perception / perception.sum(0)).T @ case.utilities
            else:
                logits = beta_2 * case.utilities[np.arange(case.percepts) % states]
            action = np.exp(logits - logits.max(1, keepdims=True))
            action /= action.sum(1, keepdims=True)
            value, sweeps = climb(case.utilities, action, beta_1, beta_2)
            reached.append(value)
            total += sweeps
        best.append(max(reached))
    return np.array(best), total


def numpy_bounds(case: Case) -> tuple[Array, int]:
    """Upper bound for each pair of prices, and their number."""
    betas = 1 / (1 / case.beta_perception + 1 / case.beta_action)
    return np.array([upper_bound(case.utilities, beta) for beta in betas]), len(betas)


def batched(case: Case) -> tuple[Array, int]:
    """Best J for each pair of prices from `bra`, and the largest number of sweeps of a restart."""
    found = serial(
        case.utilities,
        None,
        case.percepts,
        case.beta_perception,
        case.beta_action,
        restarts=case.restarts,
    )
    return np.asarray(found.objective), int(torch.as_tensor(found.iterations).max())


def timed(solve: Callable[[Case], tuple[Array, int]], case: Case) -> tuple[float, Array, int]:
    """Seconds, and what the solve returned."""
    start = time.perf_counter()
    values, sweeps = solve(case)
    return time.perf_counter() - start, values, sweeps


def main() -> None:
    """Print one line for each case."""
    torch.set_num_threads(1)
    print(
        f"{'case':<50}{'NumPy s':>9}{'+ bound':>9}{'bra s':>9}{'ratio':>8}{'all':>8}"
        f"{'J NumPy':>10}{'J bra':>10}  sweeps"
    )
    for case in cases():
        batched(case)  # the first call loads libraries
        loop, ours = [], []
        for _ in range(case.rounds):
            loop.append(timed(numpy_loop, case))
            ours.append(timed(batched, case))
        bound_s = timed(numpy_bounds, case)[0]
        loop_s, ours_s = (statistics.median(t for t, *_ in runs) for runs in (loop, ours))
        (_, loop_j, loop_sweeps), (_, our_j, our_sweeps) = loop[-1], ours[-1]
        print(
            f"{case.name:<50}{loop_s:>9.3f}{bound_s:>9.3f}{ours_s:>9.3f}{loop_s / ours_s:>8.1f}"
            f"{(loop_s + bound_s) / ours_s:>8.1f}{loop_j.mean():>10.5f}{our_j.mean():>10.5f}  "
            f"NumPy {loop_sweeps / len(loop_j) / case.restarts:.0f} on average, "
            f"bra {our_sweeps} at most",
            flush=True,
        )


if __name__ == "__main__":
    main()
