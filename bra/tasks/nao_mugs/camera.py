"""What NAO sees: its bottom camera, and a studio that gives its pictures without the robot."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bra.tasks.base import WorldError
from bra.tasks.nao_mugs.bullet import BulletClient, connect
from bra.tasks.nao_mugs.dimensions import BOTTOM_CAMERA, HEAD, TORSO_HEIGHT
from bra.tasks.nao_mugs.furniture import furnish
from bra.tasks.nao_mugs.mugs import Mug, MugKind, Pose

FIELD_OF_VIEW = (60.9, 47.6)  # degrees, across and down; Aldebaran's documentation of V4 and V5
LARGEST = 2048  # pixels
NEAR, FAR = 0.02, 5.0  # m, of what is drawn

HeadPose = tuple[Sequence[float], Sequence[float]]
"""Position, m, and orientation, a quaternion (x, y, z, w), of the head in the world."""

HEAD_AT_REST: HeadPose = ((0.0, 0.0, TORSO_HEIGHT + HEAD[0].origin[2]), (0.0, 0.0, 0.0, 1.0))
"""Of the project's own robot."""


@dataclass(frozen=True)
class Light:
    """A distant lamp and the light around.

    Attributes:
        direction: From the table towards the lamp, of any length.
        strength: Multiplies all light.
        ambient: Share of a surface's colour that is seen whatever its slope.
        diffuse: Share that grows with the cosine between surface normal and direction.
        specular: Strength of the gloss.

    Raises:
        ValueError: If the direction is none, or another number negative or not finite.
    """

    direction: tuple[float, float, float] = (-0.4, 0.3, 1.0)
    strength: float = 1.0
    ambient: float = 0.5
    diffuse: float = 0.45
    specular: float = 0.05

    def __post_init__(self) -> None:
        if len(self.direction) != 3 or not 0 < math.hypot(*self.direction) < math.inf:
            raise ValueError(
                f"the light's direction must be three numbers, not all 0, got {self.direction}"
            )
        for name in ("strength", "ambient", "diffuse", "specular"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"the light's {name} must be at least 0, got {value}")

    def arguments(self) -> dict[str, Any]:
        """Arguments for Bullet: all, as it keeps the last picture's for whatever is left out."""
        return {
            "lightDirection": list(self.direction),
            "lightColor": [1.0, 1.0, 1.0],
            "lightDistance": 2.0,
            "shadow": 0,
            "lightAmbientCoeff": self.strength * self.ambient,
            "lightDiffuseCoeff": self.strength * self.diffuse,
            "lightSpecularCoeff": self.strength * self.specular,
        }


class Camera:
    """NAO's bottom camera.

    Args:
        width: Pixels of a frame across.
        height: Pixels of a frame down.
        supersampling: Renders this many pixels for one, across and down, and averages them.

    Raises:
        ValueError: If a number is no positive integer, or more than 2048 pixels across or down
            would have to be rendered.
    """

    def __init__(self, width: int = 16, height: int = 12, supersampling: int = 1) -> None:
        for name, value in (
            ("width", width),
            ("height", height),
            ("supersampling", supersampling),
        ):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"the camera's {name} must be a positive integer, got {value!r}")
        rendered = supersampling * max(width, height)
        if rendered > LARGEST:
            raise ValueError(
                f"the camera renders at most {LARGEST} pixels across and down, "
                f"got {width} × {height} with supersampling {supersampling}"
            )
        self.width = width
        self.height = height
        self.supersampling = supersampling
        self._projection = _projection()

    def rgb(
        self, client: BulletClient, head_pose: HeadPose, light: Light | None = None
    ) -> NDArray[np.uint8]:
        """A frame in colour, (height, width, 3), 0 … 255.

        Args:
            client: The physics client whose world is seen.
            head_pose: Where the head is.
            light: How the world is lit; `Light()` if None.

        Raises:
            WorldError: If all pixels are the same: there is nothing before the camera.
        """
        return np.rint(self._average(client, head_pose, light)).astype(np.uint8)

    def grey(
        self, client: BulletClient, head_pose: HeadPose, light: Light | None = None
    ) -> NDArray[np.float32]:
        """A frame in grey, (1, height, width), 0 … 1: luma 0.299 R + 0.587 G + 0.114 B (Rec. 601).

        See `rgb`.
        """
        colours = self._average(client, head_pose, light)
        grey: NDArray[np.float32] = colours @ _LUMA
        return grey[None]

    def _average(
        self, client: BulletClient, head_pose: HeadPose, light: Light | None
    ) -> NDArray[np.float32]:
        width, height = self.width * self.supersampling, self.height * self.supersampling
        picture = client.getCameraImage(
            width,
            height,
            _view(client, head_pose),
            self._projection,
            renderer=client.ER_TINY_RENDERER,
            **(light or Light()).arguments(),
        )
        pixels = np.asarray(picture[2], dtype=np.uint8).reshape(height, width, 4)[:, :, :3]
        if (pixels == pixels[0, 0]).all():
            raise WorldError(
                f"the camera sees nothing: every pixel is {pixels[0, 0].tolist()}; "
                "does the robot's head look at the table?"
            )
        if self.supersampling == 1:
            return pixels.astype(np.float32)
        blocks = pixels.reshape(self.height, self.supersampling, self.width, self.supersampling, 3)
        average: NDArray[np.float32] = blocks.mean(axis=(1, 3), dtype=np.float32)
        return average


class Studio:
    """NAO's view of the table without NAO: the pixels of a `Scene`, several times faster.

    Args:
        camera: The camera; `Camera()` if None.
        head_pose: Where the robot's head is.

    Raises:
        ImportError: If pybullet cannot be imported.
    """

    def __init__(self, camera: Camera | None = None, head_pose: HeadPose = HEAD_AT_REST) -> None:
        self.camera = camera or Camera()
        self.head_pose = head_pose
        self._client = connect()
        # Bullet's renderer shades only what is in front of all that it has drawn: near first.
        self._mug = Mug.load(self._client, MugKind("any", left=True, right=True), Pose())
        furnish(self._client)

    def rgb(self, kind: MugKind, pose: Pose, light: Light | None = None) -> NDArray[np.uint8]:
        """A frame in colour of a mug on the table; see `Camera.rgb`."""
        self._arrange(kind, pose)
        return self.camera.rgb(self._client, self.head_pose, light)

    def grey(self, kind: MugKind, pose: Pose, light: Light | None = None) -> NDArray[np.float32]:
        """A frame in grey of a mug on the table; see `Camera.grey`."""
        self._arrange(kind, pose)
        return self.camera.grey(self._client, self.head_pose, light)

    def close(self) -> None:
        """Ends the simulation; closing again does nothing."""
        self._client.close()

    def _arrange(self, kind: MugKind, pose: Pose) -> None:
        self._mug.move(pose)
        self._mug.show(kind.handles)


_LUMA = np.array([0.299 / 255, 0.587 / 255, 0.114 / 255], dtype=np.float32)


def _projection() -> tuple[float, ...]:
    """OpenGL's projection matrix, by columns; Bullet's own takes pixels for square."""
    across, down = (1 / math.tan(math.radians(angle) / 2) for angle in FIELD_OF_VIEW)
    depth = NEAR - FAR
    return (
        *(across, 0.0, 0.0, 0.0),
        *(0.0, down, 0.0, 0.0),
        *(0.0, 0.0, (NEAR + FAR) / depth, -1.0),
        *(0.0, 0.0, 2 * NEAR * FAR / depth, 0.0),
    )


def _view(client: BulletClient, head_pose: HeadPose) -> Any:
    """Bullet's view matrix of the camera on a head."""
    # Bullet's link poses are off by rounding, which may tip a pixel.
    position, orientation = ([round(value, 6) for value in part] for part in head_pose)
    offset, pitch = BOTTOM_CAMERA
    level = [0.0, 0.0, 0.0, 1.0]
    ahead = [offset[0] + math.cos(pitch), offset[1], offset[2] - math.sin(pitch)]
    above = [math.sin(pitch), 0.0, math.cos(pitch)]
    eye, _ = client.multiplyTransforms(position, orientation, offset, level)
    target, _ = client.multiplyTransforms(position, orientation, ahead, level)
    up, _ = client.multiplyTransforms([0.0, 0.0, 0.0], orientation, above, level)
    return client.computeViewMatrix(eye, target, up)
