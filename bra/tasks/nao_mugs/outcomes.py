"""How often every action lifts every mug when the mugs do not stand where they should."""

import csv
import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bra.checks.words import amount
from bra.pictures import draw_heatmap
from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import ACTIONS, HANDS, lift
from bra.tasks.nao_mugs.mugs import MUGS
from bra.tasks.nao_mugs.scene import Scene


@dataclass(frozen=True)
class SuccessMatrix:
    """Counts of lifts; rows are the mugs in the order of `MUGS`, columns the `ACTIONS`.

    Attributes:
        attempts: Lifts tried, (4, 4).
        successes: Those after which the mug was up and upright, (4, 4).
        rise: Mean rise of the mug, (4, 4), m.
        tilt: Mean tilt of the mug, (4, 4), rad.
        jitter: Where the mugs stood.
    """

    attempts: NDArray[np.int64]
    successes: NDArray[np.int64]
    rise: NDArray[np.float64]
    tilt: NDArray[np.float64]
    jitter: Jitter

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

    def draw(self) -> Image.Image:
        """A heatmap of the shares with the counts in its cells; white is 0, dark blue 1."""
        hands = ["no hand", *(" + ".join(each) for each in HANDS[1:])]
        handles = [" + ".join(mug.handles) or "no handle" for mug in MUGS]
        counts = zip(self.successes.flat, self.attempts.flat, strict=True)
        jitter = f"±{100 * self.jitter.position:g} cm, ±{self.jitter.angle:g}°"
        return draw_heatmap(
            self.rates,
            [f"{mug.name}\n{handle}" for mug, handle in zip(MUGS, handles, strict=True)],
            [f"{action}\n{hand}" for action, hand in zip(ACTIONS, hands, strict=True)],
            f"Mugs lifted, by handles and hands used\n"
            f"{amount(int(self.attempts.max()), 'trial')} each, mug placed within {jitter}",
            np.array([f"{part}/{whole}" for part, whole in counts]).reshape(self.rates.shape),
        )


def try_lifts(scene: Scene, trials: int, jitter: Jitter, seed: int = 0) -> NDArray[np.object_]:
    """Executes all actions on all mugs, each time at another pose, which the robot knows.

    Args:
        scene: To lift in; what is in it is replaced.
        trials: Lifts for each of the 16 pairs of mug and action.
        jitter: Where the mugs stand.
        seed: Of the poses, at least 0. A pose depends on seed, mug, action and trial alone.

    Returns:
        An `Outcome` per mug, action and trial, (4, 4, trials).
    """
    outcomes = np.empty((len(MUGS), len(ACTIONS), trials), dtype=object)
    for mug, action, trial in np.ndindex(outcomes.shape):
        numbers = np.random.default_rng((seed, mug, action, trial)).random(Jitter.NUMBERS)
        pose = jitter.pose(numbers)
        scene.place(MUGS[mug], pose)
        outcomes[mug, action, trial] = lift(scene, action, pose)
    return outcomes


def success_matrix(scene: Scene, trials: int, jitter: Jitter, seed: int = 0) -> SuccessMatrix:
    """Counts which action lifts which mug; see `try_lifts`.

    Raises:
        ValueError: If there are no trials, or the seed is negative.
    """
    if trials < 1 or seed < 0:
        raise ValueError(f"trials must be positive and seed not negative, got {trials} and {seed}")
    outcomes = try_lifts(scene, trials, jitter, seed)

    def each(name: str) -> NDArray[np.float64]:
        return np.vectorize(lambda outcome: float(getattr(outcome, name)))(outcomes)  # type: ignore[no-any-return]  # an array

    return SuccessMatrix(
        attempts=np.full(outcomes.shape[:2], trials),
        successes=each("success").sum(-1).astype(np.int64),
        rise=each("rise").mean(-1),
        tilt=each("tilt").mean(-1),
        jitter=jitter,
    )
