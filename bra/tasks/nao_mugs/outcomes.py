"""How often every action lifts every mug when the mugs do not stand where they should."""

import csv
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bra.tasks.nao_mugs.lift import ACTIONS, HANDS, check_pose, lift
from bra.tasks.nao_mugs.mugs import MUGS, Pose
from bra.tasks.nao_mugs.scene import Scene

CENTRE = Pose()


@dataclass(frozen=True)
class SuccessMatrix:
    """Counts of lifts; rows are the mugs in the order of `MUGS`, columns the `ACTIONS`.

    Attributes:
        attempts: Lifts tried, (4, 4).
        successes: Those after which the mug was up and upright, (4, 4).
        rise: Mean rise of the mug, (4, 4), m.
        tilt: Mean tilt of the mug, (4, 4), rad.
        position_jitter: Largest shift of a mug in x and in y, m.
        angle_jitter: Largest turn of a mug, rad.
    """

    attempts: NDArray[np.int64]
    successes: NDArray[np.int64]
    rise: NDArray[np.float64]
    tilt: NDArray[np.float64]
    position_jitter: float
    angle_jitter: float

    @property
    def rates(self) -> NDArray[np.float64]:
        """Shares of lifts that succeeded, (4, 4)."""
        return self.successes / self.attempts

    def write_csv(self, path: str) -> None:
        """Writes a row per mug and action: counts, mean rise in m, mean tilt in rad."""
        with open(path, "w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(
                ["mug", "action", "attempts", "successes", "mean_rise_m", "mean_tilt_rad"]
            )
            for cell in itertools.product(range(len(MUGS)), range(len(ACTIONS))):
                names = MUGS[cell[0]].name, ACTIONS[cell[1]]
                counts = self.attempts[cell], self.successes[cell]
                rows.writerow([*names, *counts, f"{self.rise[cell]:.6f}", f"{self.tilt[cell]:.6f}"])

    def draw(self) -> Figure:
        """A heatmap of the shares with the counts in its cells; white is 0, dark blue 1."""
        figure = Figure(figsize=(4.2, 3.1), dpi=120)
        axes = figure.add_axes((0.27, 0.14, 0.70, 0.66))
        axes.imshow(self.rates, vmin=0, vmax=1, cmap="Blues", aspect="auto")
        actions = [
            f"{name}\n{' + '.join(hands)}" for name, hands in zip(ACTIONS, HANDS, strict=True)
        ]
        actions[0] += "no hand"
        mugs = [f"{mug.name}\n{' + '.join(mug.handles) or 'no handle'}" for mug in MUGS]
        axes.set_xticks(range(len(ACTIONS)), actions)
        axes.set_yticks(range(len(MUGS)), mugs)
        axes.tick_params(length=0, labelsize=9)
        for cell in itertools.product(range(len(MUGS)), range(len(ACTIONS))):
            colour = "white" if self.rates[cell] > 0.6 else "black"
            text = f"{self.successes[cell]}/{self.attempts[cell]}"
            axes.text(cell[1], cell[0], text, ha="center", va="center", color=colour, fontsize=10)
        jitter = f"±{100 * self.position_jitter:g} cm, ±{math.degrees(self.angle_jitter):.3g}°"
        figure.suptitle(
            f"Mugs lifted, by handles and hands used\n"
            f"{self.attempts.max()} trials each, mug placed within {jitter}",
            fontsize=10,
        )
        return figure


def jittered_pose(
    position_jitter: float, angle_jitter: float, key: tuple[int, int, int, int]
) -> Pose:
    """A pose drawn uniformly from around the middle of the table.

    Args:
        position_jitter: Largest shift in x and in y, m.
        angle_jitter: Largest turn, rad.
        key: Seed, mug, action and trial, which alone decide the draw.
    """
    x, y, turn = np.random.default_rng(key).uniform(-1.0, 1.0, 3)
    return Pose(
        CENTRE.x + float(x) * position_jitter,
        CENTRE.y + float(y) * position_jitter,
        CENTRE.yaw + float(turn) * angle_jitter,
    )


def success_matrix(
    scene: Scene,
    trials: int = 100,
    position_jitter: float = 0.01,
    angle_jitter: float = math.radians(10),
    seed: int = 0,
    report: Callable[[int, int], None] | None = None,
) -> SuccessMatrix:
    """Tries all actions on all mugs, each time at another pose, which the robot knows.

    Args:
        scene: To lift in; what is in it is replaced.
        trials: Lifts for each of the 16 pairs of mug and action.
        position_jitter: Largest shift of a mug in x and in y, m.
        angle_jitter: Largest turn of a mug, rad.
        seed: Of the poses.
        report: Called after every lift with the lifts done and those in all.

    Raises:
        ValueError: If there are no trials, the seed or a jitter is negative, or mugs could come to
            stand out of reach.
    """
    if trials < 1 or seed < 0:
        raise ValueError(f"trials must be positive and seed not negative, got {trials} and {seed}")
    if not (position_jitter >= 0 and angle_jitter >= 0):
        raise ValueError(
            f"jitter must not be negative, got {position_jitter} m, {angle_jitter} rad"
        )
    for sign in (1, -1):  # the farthest and the nearest place
        x = CENTRE.x + sign * position_jitter
        check_pose(Pose(x, CENTRE.y + position_jitter, CENTRE.yaw + angle_jitter))
    shape = len(MUGS), len(ACTIONS)
    successes, rise, tilt = np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape)
    tries = itertools.product(range(len(MUGS)), range(len(ACTIONS)), range(trials))
    for done, (mug, action, trial) in enumerate(tries, start=1):
        pose = jittered_pose(position_jitter, angle_jitter, (seed, mug, action, trial))
        scene.place(MUGS[mug], pose)
        outcome = lift(scene, action, pose)
        successes[mug, action] += outcome.success
        rise[mug, action] += outcome.rise / trials
        tilt[mug, action] += outcome.tilt / trials
        if report is not None:
            report(done, trials * len(MUGS) * len(ACTIONS))
    attempts = np.full(shape, trials, np.int64)
    return SuccessMatrix(attempts, successes, rise, tilt, position_jitter, angle_jitter)
