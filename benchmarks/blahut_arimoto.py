"""Time of `bra.blahut_arimoto.serial` against the same equations as a NumPy loop.

    python benchmarks/blahut_arimoto.py

Both sides use one core, take the same number of starts of the same kinds, and stop each climb on
the same certificate at the same tolerance.

NumPy: what one would write by hand. One restart after another, one pair of prices after another,
    plain sweeps of the self-consistent equations without extrapolation. J is evaluated once, at
    the end of a climb.
bra: all restarts and prices as one batch, sweeps with SQUAREM, and the whole of `serial`: input
    checks, starts, certificates, all terms of J, and the upper bound. What the bound would cost by
    plain one-channel Blahut-Arimoto, one price after another, is shown as "+ bound"; the last ratio
    counts it on the NumPy side.

The two run in turn, and medians of the processor's time are compared, so that others may use it.
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

from bra.blahut_arimoto import serial
from bra.blahut_arimoto.climb import SWEEP_CAP
from bra.blahut_arimoto.mixture_likelihood import GAP_TOLERANCE
from bra.blahut_arimoto.serial_problem import CLIMB_TOLERANCE
from bra.tasks.predator_prey import HUNTING

Array = NDArray[np.float64]

TINY = 1e-200

PREDATOR_PREY = np.array(HUNTING)


@dataclass(frozen=True)
class Case:
    """One problem with a uniform prior, solved for every pair of the given prices."""

    name: str
    utilities: Array
    percepts: int
    prices: tuple[Array, Array]
    restarts: int
    rounds: int


def cases() -> list[Case]:
    """The three problems: one cell, a grid of prices, a large table."""
    grid = np.meshgrid(np.geomspace(0.5, 20.0, 20), np.geomspace(0.5, 20.0, 20), indexing="ij")
    return [
        Case(
            name="predator-prey (8,10), |X| = 13, 32 restarts",
            utilities=PREDATOR_PREY,
            percepts=13,
            prices=(np.array([8.0]), np.array([10.0])),
            restarts=32,
            rounds=15,
        ),
        Case(
            name="predator-prey 20×20 prices, |X| = 13, 8 restarts",
            utilities=PREDATOR_PREY,
            percepts=13,
            prices=(grid[0].ravel(), grid[1].ravel()),
            restarts=8,
            rounds=1,  # the loop takes minutes
        ),
        Case(
            name="random 300×300 (10,10), |X| = 300, 1 restart",
            utilities=np.random.default_rng(0).random((300, 300)),
            percepts=300,
            prices=(np.array([10.0]), np.array([10.0])),
            restarts=1,
            rounds=5,
        ),
    ]


def bra_serial(case: Case) -> tuple[Array, str]:
    """Best J for each pair of prices, and the number of sweeps of the restart that took most."""
    starts = {"restarts": case.restarts, "budget": case.restarts}
    found = serial(case.utilities, None, case.percepts, *case.prices, **starts)
    most = int(torch.as_tensor(found.iterations).max())
    return np.asarray(found.objective), f"bra {most} at most"


def numpy_loop(case: Case) -> tuple[Array, str]:
    """Best J for each pair of prices, and the average number of sweeps of a restart."""
    rng = np.random.default_rng(0)
    best, total = [], 0
    for beta_1, beta_2 in zip(*case.prices, strict=True):
        reached = []
        for restart in range(case.restarts):
            action = start(case, restart, beta_2, rng)
            value, sweeps = climb(case.utilities, action, beta_1, beta_2)
            reached.append(value)
            total += sweeps
        best.append(max(reached))
    return np.array(best), f"NumPy {total / len(best) / case.restarts:.0f} on average"


def start(case: Case, restart: int, beta_2: float, rng: np.random.Generator) -> Array:
    """p(a|x): diagonal, covering, or from a random perception."""
    states, actions = case.utilities.shape
    if restart == 0:
        return normalised(beta_2 * case.utilities[np.arange(case.percepts) % states])
    if restart % 2:
        favourite = rng.permutation(max(actions, case.percepts))[: case.percepts] % actions
        return normalised(5.0 * np.eye(actions)[favourite])
    perception = normalised(10 * rng.random() * rng.standard_normal((states, case.percepts)))
    return normalised(beta_2 * (perception / perception.sum(0)).T @ case.utilities)


def climb(utilities: Array, action: Array, beta_1: float, beta_2: float) -> tuple[float, int]:
    """Blahut-Arimoto from the channel p(a|x); returns J and the number of sweeps."""
    prior = np.full(len(utilities), 1 / len(utilities))
    percept = np.full(len(action), 1 / len(action))
    marginal = percept @ action
    rounding = 16 * np.finfo(float).eps * (1 / beta_1 + 1 / beta_2)
    tolerance = CLIMB_TOLERANCE * np.ptp(utilities) + rounding
    action_gain = np.inf
    sweeps = 0
    while sweeps < SWEEP_CAP:
        sweeps += 1
        cost = (action * np.log(np.maximum(action, TINY) / marginal)).sum(1)
        perception = normalised(beta_1 * (utilities @ action.T - cost / beta_2), percept)
        joint = prior[:, None] * perception
        renewed = np.maximum(joint.sum(0), TINY)
        perception_gain = np.log((renewed / percept).max()) / beta_1
        if perception_gain + action_gain <= tolerance:
            break
        percept = renewed
        action = normalised(beta_2 * (joint.T @ utilities) / percept[:, None], marginal)
        renewed = np.maximum(percept @ action, TINY)
        action_gain = np.log((renewed / marginal).max()) / beta_2
        marginal = renewed
    return objective(utilities, perception, action, beta_1, beta_2), sweeps


def normalised(logits: Array, weights: Array | float = 1.0) -> Array:
    """Rows proportional to weights · exp(logits)."""
    rows = weights * np.exp(logits - logits.max(1, keepdims=True))
    return rows / rows.sum(1, keepdims=True)


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
    ratio = conditional / np.maximum(prior @ conditional, TINY)
    return float(prior @ (conditional * np.log(np.maximum(ratio, TINY))).sum(1))


def numpy_bounds(case: Case) -> tuple[Array, str]:
    """One-channel optimum plus its certified gap for each pair of prices."""
    beta_1, beta_2 = case.prices
    return np.array([upper_bound(case.utilities, b) for b in 1 / (1 / beta_1 + 1 / beta_2)]), ""


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


def timed(solve: Callable[[Case], tuple[Array, str]], case: Case) -> tuple[float, Array, str]:
    """Seconds, and what the solve returned."""
    begin = time.process_time()
    values, sweeps = solve(case)
    return time.process_time() - begin, values, sweeps


def main() -> None:
    """Print one line for each case."""
    torch.set_num_threads(1)
    print(
        f"{'case':<50}{'NumPy s':>9}{'+ bound':>9}{'bra s':>9}{'ratio':>8}{'all':>8}"
        f"{'J NumPy':>10}{'J bra':>10}  sweeps"
    )
    for case in cases():
        bra_serial(case)  # the first call loads libraries
        loop, ours = [], []
        for _ in range(case.rounds):
            loop.append(timed(numpy_loop, case))
            ours.append(timed(bra_serial, case))
        bound_s = timed(numpy_bounds, case)[0]
        loop_s, ours_s = (statistics.median(t for t, *_ in runs) for runs in (loop, ours))
        (_, loop_j, loop_sweeps), (_, our_j, our_sweeps) = loop[-1], ours[-1]
        print(
            f"{case.name:<50}{loop_s:>9.3f}{bound_s:>9.3f}{ours_s:>9.3f}{loop_s / ours_s:>8.1f}"
            f"{(loop_s + bound_s) / ours_s:>8.1f}{loop_j.mean():>10.5f}{our_j.mean():>10.5f}  "
            f"{loop_sweeps}, {our_sweeps}",
            flush=True,
        )


if __name__ == "__main__":
    main()
