"""How encounters with the same mug differ: where it stands, how it is lit."""

import itertools
import math
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from bra.checks.settings import check_real
from bra.tasks.nao_mugs.camera import Light
from bra.tasks.nao_mugs.lift import check_pose
from bra.tasks.nao_mugs.mugs import Pose


@dataclass(frozen=True)
class Jitter:
    """Uniform spreads around the usual pose and light.

    Attributes:
        position: Largest shift of the mug along x and along y, m.
        angle: Largest turn of the mug about the vertical, degrees.
        light: Largest relative change of the light's strength, and largest shift of the lamp's
            direction along x and along y, in units of its height; less than 1.

    Raises:
        ValueError: If a spread is negative, or leads to poses out of the robot's reach.
    """

    position: float = 0.0
    angle: float = 0.0
    light: float = 0.0

    NUMBERS = 6
    """Random numbers that an encounter takes."""

    def __post_init__(self) -> None:
        for name, value in zip(("position", "angle", "light"), astuple(self), strict=True):
            check_real(value, f"{name}_jitter", "at least 0", lambda value: value >= 0)
        if self.light >= 1:
            raise ValueError(f"light_jitter must be less than 1, got {self.light}")
        for corner in itertools.product((0.0, 1.0), repeat=3):
            try:
                check_pose(self.pose(np.array(corner)))
            except ValueError as error:
                raise ValueError(
                    f"position_jitter {self.position} m and angle_jitter {self.angle}° put the mug "
                    f"out of reach: {error}"
                ) from error

    @property
    def moves(self) -> bool:
        """Whether the mug stands elsewhere every time."""
        return bool(self.position or self.angle)

    @property
    def varies(self) -> bool:
        """Whether frames of the same mug differ."""
        return any(astuple(self))

    def pose(self, uniform: NDArray[np.float64]) -> Pose:
        """Where the mug stands, from the first three of the encounter's numbers in [0, 1)."""
        usual = Pose()
        x, y, turn = 2 * uniform[:3] - 1
        return Pose(
            x=usual.x + self.position * float(x),
            y=usual.y + self.position * float(y),
            yaw=usual.yaw + math.radians(self.angle) * float(turn),
        )

    def lamp(self, uniform: NDArray[np.float64]) -> Light:
        """How it is lit, from the last three of the encounter's numbers in [0, 1)."""
        usual = Light()
        across, along, strength = 2 * uniform[3:] - 1
        x, y, height = usual.direction
        shift = self.light * height
        return Light(
            direction=(x + shift * float(across), y + shift * float(along), height),
            strength=usual.strength * (1 + self.light * float(strength)),
        )
