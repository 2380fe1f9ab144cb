"""The four mugs: no handle, a left one, a right one, both."""

import math
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bra.checks.words import amount
from bra.tasks.nao_mugs.bullet import BulletClient
from bra.tasks.nao_mugs.furniture import TABLE_HEIGHT
from bra.tasks.nao_mugs.meshes import lathe, tube

Side = Literal["left", "right"]
SIDES: dict[Side, int] = {"left": 1, "right": -1}  # sign of y in the mug's frame

CUP_RADIUS = 0.032  # m
CUP_HEIGHT = 0.080  # m
HANDLE_REACH = 0.060  # m, from the cup's axis to the bar's
HANDLE_HEIGHT = 0.042  # m, of the bar's centre above the table
HANDLE_LENGTH = 0.046  # m
HANDLE_RADIUS = 0.0045  # m
HANDLE_MASS = 0.008  # kg each
MUG_MASS = 0.2  # kg, handles included

WALL = 0.004  # m, of the cup as it looks
CUP_COLOUR = (0.75, 0.10, 0.08)
INSIDE_COLOUR = (0.93, 0.88, 0.80)


@dataclass(frozen=True)
class MugKind:
    """What distinguishes the mugs: the handles.

    Attributes:
        name: A short name.
        left: Has a handle on the robot's left, +y.
        right: Has a handle on the robot's right, −y.
    """

    name: str
    left: bool
    right: bool

    @property
    def handles(self) -> tuple[Side, ...]:
        """The sides that have a handle."""
        return tuple(side for side in SIDES if getattr(self, side))


MUGS = (
    MugKind("m0", left=False, right=False),
    MugKind("mL", left=True, right=False),
    MugKind("mR", left=False, right=True),
    MugKind("m2", left=True, right=True),
)


@dataclass(frozen=True)
class Pose:
    """Where a mug stands on the table.

    Attributes:
        x: Its axis, forward of the robot, m.
        y: Its axis, to the robot's left, m.
        yaw: Turn about the vertical, rad; the left handle points along +y at 0.
    """

    x: float = 0.17
    y: float = 0.0
    yaw: float = 0.0


def handle_centre(pose: Pose, side: Side) -> NDArray[np.float64]:
    """Centre of a side's bar in the world, (3,), m: (x, y) + R(yaw)·(0, ±0.060), 0.042 up."""
    reach = SIDES[side] * HANDLE_REACH
    x, y = pose.x - reach * math.sin(pose.yaw), pose.y + reach * math.cos(pose.yaw)
    return np.array([x, y, TABLE_HEIGHT + HANDLE_HEIGHT])


class Mug:
    """A mug in a simulation. Its frame and centre of mass lie at the middle of the cup.

    Args:
        client: The physics client that holds it.
        body: Its body's id.

    Attributes:
        client: The physics client that holds it.
        body: Its body's id.
        handles: The link of each handle by side; sides without one are missing.
    """

    def __init__(self, client: BulletClient, body: int) -> None:
        self.client = client
        self.body = body
        links = [client.getJointInfo(body, i) for i in range(client.getNumJoints(body))]
        names = {link[12].decode(): link[0] for link in links}
        self.handles: dict[Side, int] = {
            side: names[f"{side}_handle"] for side in SIDES if f"{side}_handle" in names
        }

    @classmethod
    def load(cls, client: BulletClient, kind: MugKind, pose: Pose, mass: float = MUG_MASS) -> "Mug":
        """Stands a new mug on the table.

        Args:
            client: The physics client to load it into.
            kind: Which mug.
            pose: Where it stands.
            mass: Of cup and handles, kg.

        Raises:
            ValueError: If the mass leaves nothing for the cup.
        """
        files = mug_meshes(kind) | {"mug.urdf": mug_urdf(kind, mass)}
        client.setPhysicsEngineParameter(enableFileCaching=0)  # the names are used once
        with tempfile.TemporaryDirectory() as folder:  # Bullet reads descriptions from files only
            for name, text in files.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            body = client.loadURDF(
                str(Path(folder) / "mug.urdf"),
                *_stand(client, pose),
                flags=client.URDF_USE_INERTIA_FROM_FILE | client.URDF_USE_IMPLICIT_CYLINDER,
            )
        return cls(client, body)

    def move(self, pose: Pose) -> None:
        """Stands the mug elsewhere on the table, upright and at rest."""
        self.client.resetBasePositionAndOrientation(self.body, *_stand(self.client, pose))
        self.client.resetBaseVelocity(self.body, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])

    def show(self, handles: Collection[Side]) -> None:
        """Makes the handles of these sides visible, and the others invisible; both stay solid."""
        for side, link in self.handles.items():
            alpha = 1.0 if side in handles else 0.0
            self.client.changeVisualShape(self.body, link, rgbaColor=[*CUP_COLOUR, alpha])

    def remove(self) -> None:
        """Takes the mug, and the constraints on it, out of the simulation."""
        ids = [self.client.getConstraintUniqueId(i) for i in range(self.client.getNumConstraints())]
        for constraint in ids:  # Bullet leaves those of a removed body dangling
            parent, _, child, *_ = self.client.getConstraintInfo(constraint)
            if self.body in (parent, child):
                self.client.removeConstraint(constraint)
        self.client.removeBody(self.body)

    def position(self) -> NDArray[np.float64]:
        """The middle of the cup in the world, (3,), m."""
        return np.array(self.client.getBasePositionAndOrientation(self.body)[0])

    def tilt(self) -> float:
        """Angle between the cup's axis and the vertical, rad."""
        orientation = self.client.getBasePositionAndOrientation(self.body)[1]
        upright = self.client.getMatrixFromQuaternion(orientation)[8]
        return math.acos(min(max(upright, -1.0), 1.0))


def mug_urdf(kind: MugKind, mass: float = MUG_MASS) -> str:
    """A mug's description: a cup, and a link "left_handle", "right_handle" for each handle.

    Its looks refer to the files of `mug_meshes` in the same folder.

    Args:
        kind: Which mug.
        mass: Of cup and handles, kg.

    Raises:
        ValueError: If the mass leaves nothing for the cup.
    """
    cup_mass = mass - HANDLE_MASS * len(kind.handles)
    if not cup_mass > 0:
        raise ValueError(
            f"a mug must weigh more than its {amount(len(kind.handles), 'handle')} of "
            f"{HANDLE_MASS} kg, got {mass} kg"
        )
    across = cup_mass * (6 * CUP_RADIUS**2 + CUP_HEIGHT**2) / 12  # a thin-walled tube's
    along = cup_mass * CUP_RADIUS**2
    return f"""<robot name="{kind.name}">
  <link name="cup">
    {_inertial(cup_mass, across, along)}
    {_CONTACT}
    {_visual("inside.obj", INSIDE_COLOUR)}
    {_visual("outside.obj", CUP_COLOUR)}
    {_collision(CUP_RADIUS, CUP_HEIGHT)}
  </link>{"".join(_handle(side) for side in kind.handles)}
</robot>
"""


@cache
def mug_meshes(kind: MugKind) -> dict[str, str]:
    """The looks of a mug by file name, as text of OBJ files, m."""
    inner, top, floor = CUP_RADIUS - WALL, CUP_HEIGHT / 2, WALL - CUP_HEIGHT / 2
    meshes = {
        "outside.obj": lathe([(CUP_RADIUS, -top), (CUP_RADIUS, top), (inner, top)]),
        "inside.obj": lathe([(inner, top), (inner, floor), (0.0, floor)]),
    }
    bar = HANDLE_LENGTH / 2 - HANDLE_RADIUS
    for side in kind.handles:
        cup = -SIDES[side] * (HANDLE_REACH - CUP_RADIUS + WALL / 2)  # ends inside the wall
        path = [(cup, bar), (0.0, bar), (0.0, -bar), (cup, -bar)]
        meshes[f"{side}_handle.obj"] = tube(path, HANDLE_RADIUS)
    return meshes


def _handle(side: Side) -> str:
    """A bar that can be gripped; the struts that hold it are only seen: jaws need the room."""
    across = HANDLE_MASS * (3 * HANDLE_RADIUS**2 + HANDLE_LENGTH**2) / 12
    along = HANDLE_MASS * HANDLE_RADIUS**2 / 2
    return f"""
  <link name="{side}_handle">
    {_inertial(HANDLE_MASS, across, along)}
    {_CONTACT}
    {_visual(f"{side}_handle.obj", CUP_COLOUR)}
    {_collision(HANDLE_RADIUS, HANDLE_LENGTH)}
  </link>
  <joint name="{side}_handle" type="fixed">
    <parent link="cup"/><child link="{side}_handle"/>
    <origin xyz="0 {SIDES[side] * HANDLE_REACH} {HANDLE_HEIGHT - CUP_HEIGHT / 2}"/>
  </joint>"""


def _stand(client: BulletClient, pose: Pose) -> tuple[list[float], list[float]]:
    """Position and orientation of a mug's frame, as Bullet takes them."""
    position = [pose.x, pose.y, TABLE_HEIGHT + CUP_HEIGHT / 2]
    return position, client.getQuaternionFromEuler([0.0, 0.0, pose.yaw])


_CONTACT = '<contact><lateral_friction value="0.8"/><spinning_friction value="0.001"/></contact>'


def _inertial(mass: float, across: float, along: float) -> str:
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{across}" iyy="{across}" izz="{along}" '
        'ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _visual(file: str, colour: tuple[float, float, float]) -> str:
    red, green, blue = colour
    return (
        f'<visual><geometry><mesh filename="{file}"/></geometry>'
        f'<material name="{file}"><color rgba="{red} {green} {blue} 1"/></material></visual>'
    )


def _collision(radius: float, length: float) -> str:
    shape = f'<cylinder radius="{radius}" length="{length}"/>'
    return f"<collision><geometry>{shape}</geometry></collision>"
