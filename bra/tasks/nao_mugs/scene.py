"""A robot behind a table with a mug on it."""

from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from bra.tasks.nao_mugs.bullet import BulletClient, connect
from bra.tasks.nao_mugs.furniture import TABLE_EDGE, TABLE_HEIGHT, add_legs, furnish
from bra.tasks.nao_mugs.mugs import Mug, MugKind, Pose
from bra.tasks.nao_mugs.robot import Robot

GRAVITY = 9.81  # m/s²
TIME_STEP = 1 / 240  # s
LASTS = 500
"""Mugs until a simulation is replaced: Bullet keeps 2 KB of each, until it is disconnected."""

__all__ = ["TABLE_EDGE", "TABLE_HEIGHT", "Scene"]


class Scene:
    """Floor, table, robot and at most one mug, in a simulation of their own.

    The z axis points up from the floor, x forward from the robot, y to its left. Belongs to the
    process that made it. Usable in a `with` statement, which closes it.

    Args:
        robot_urdf: Path of a robot's description; the project's own robot if None.
        gui: Opens a window.

    Attributes:
        client: The physics client; without a window, another one after `LASTS` mugs.
        robot: The robot, at rest until told otherwise.
        mug: The mug on the table, or None before the first `place`.

    Raises:
        ImportError: If pybullet cannot be imported.
        RuntimeError: If a window is asked for and there is no display.
        ValueError: If the robot's description does not serve.
    """

    def __init__(self, robot_urdf: str | None = None, gui: bool = False) -> None:
        self._urdf, self._gui = robot_urdf, gui
        self._build()

    def _build(self) -> None:
        """Connects to a new simulation, and fills it."""
        self.client: BulletClient = connect(self._gui)
        self.mug: Mug | None = None
        self._placed = 0
        try:
            self.client.setGravity(0.0, 0.0, -GRAVITY)
            self.client.setPhysicsEngineParameter(
                fixedTimeStep=TIME_STEP, deterministicOverlappingPairs=1
            )
            furnish(self.client)
            add_legs(self.client)
            self.robot = Robot(self.client, self._urdf)
            if self._gui:
                self.client.configureDebugVisualizer(self.client.COV_ENABLE_GUI, 0)
                self.client.resetDebugVisualizerCamera(
                    cameraDistance=0.5,
                    cameraYaw=65,
                    cameraPitch=-35,
                    cameraTargetPosition=[0.07, 0.0, 0.40],
                )
        except Exception:
            self.close()
            raise

    def place(self, kind: MugKind, pose: Pose) -> Mug:
        """Starts over: the robot at rest, and a new mug instead of the old one.

        What follows depends on the mug, its pose and the robot's commands, to the last bit, and
        not on what the scene was used for before.

        Args:
            kind: Which mug.
            pose: Where it stands.
        """
        if self._placed >= LASTS and not self._gui:
            self.close()
            self._build()
        self._placed += 1
        if self.mug is not None:
            self.mug.remove()
            self.mug = None
        self.robot.reset()
        self.mug = Mug.load(self.client, kind, pose)
        return self.mug

    def step(self, count: int = 1) -> None:
        """Lets `count` time steps of 1/240 s pass."""
        for _ in range(count):
            self.client.stepSimulation()

    def window(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        """The scene as a bystander sees it, (height, width, 3); slow, about 0.2 s."""
        view = self.client.computeViewMatrix(
            [0.60, -0.26, 0.86], [0.07, 0.01, 0.41], [0.0, 0.0, 1.0]
        )
        projection = self.client.computeProjectionMatrixFOV(38.0, width / height, 0.05, 10.0)
        # Bullet keeps the light of the last picture for whatever is left out.
        pixels = self.client.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=[1.0, -0.5, 1.8],
            lightColor=[1.0, 1.0, 1.0],
            lightDistance=6.0,  # nearer, the far floor would count as shadow
            shadow=1,
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.1,
            renderer=self.client.ER_TINY_RENDERER,
        )[2]
        return np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()

    def close(self) -> None:
        """Ends the simulation; closing again does nothing."""
        self.client.close()

    def __enter__(self) -> "Scene":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
