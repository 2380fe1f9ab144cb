"""The robot in a simulation: its joints by name, its motors, its hands."""

import os
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bra.tasks.nao_mugs.bullet import BulletClient
from bra.tasks.nao_mugs.dimensions import (
    HEAD_JOINTS,
    JAW_OPENING,
    TORSO_HEIGHT,
    arm_joints,
    jaw_joints,
    rest_posture,
)
from bra.tasks.nao_mugs.kinematics import Array, KinematicChain
from bra.tasks.nao_mugs.mugs import SIDES, Side
from bra.tasks.nao_mugs.urdf import nao_urdf

Frame = tuple[tuple[float, ...], tuple[float, ...]]
"""Position, m, and orientation as a quaternion (x, y, z, w)."""


@dataclass(frozen=True)
class Arm:
    """One arm. Bullet numbers a joint and the link that it carries alike.

    Attributes:
        chain: From the torso to the gripper, whose origin is the point to grip with.
        joints: The five joints' numbers.
        gripper: The link that carries the jaws.
        jaws: The jaws' numbers, outer and inner.
    """

    chain: KinematicChain
    joints: tuple[int, ...]
    gripper: int
    jaws: tuple[int, ...]


class Robot:
    """A NAO that stands behind the table, its torso fixed.

    Its motors follow targets with the efforts that the description allows; other joints than those
    of head, arms and jaws are held at 0.

    Args:
        client: The physics client to load it into.
        urdf: Path of a description with NAO's joints, and jaws that slide (LFinger, LThumb,
            RFinger, RThumb); its root is the torso. The project's own robot if None.

    Attributes:
        client: The physics client.
        body: Its body's id.
        joints: Numbers of the moving joints by name.
        arms: Both arms, by side.

    Raises:
        ValueError: If there is no such file, it is no URDF, or joints are missing.
    """

    def __init__(self, client: BulletClient, urdf: str | None = None) -> None:
        self.client = client
        description = nao_urdf() if urdf is None else _read(urdf)
        self.body = _load(client, description, urdf)
        infos = [client.getJointInfo(self.body, i) for i in range(client.getNumJoints(self.body))]
        moving = [info for info in infos if info[2] != client.JOINT_FIXED]
        self.joints = {info[1].decode(): int(info[0]) for info in moving}
        self._efforts = {int(info[0]): float(info[10]) for info in moving}
        self._rest = {name: rest_posture().get(name, 0.0) for name in self.joints}
        for side in SIDES:
            self._rest |= dict.fromkeys(jaw_joints(side), JAW_OPENING)
        self.arms = {side: self._arm(description, infos, side) for side in SIDES}
        self.reset()

    def reset(self) -> None:
        """Puts all joints at rest, arms at the sides and hands open, and holds them there."""
        for name, joint in self.joints.items():
            self.client.resetJointState(self.body, joint, self._rest[name], 0.0)
        self._drive(list(self.joints.values()), [self._rest[name] for name in self.joints])

    def rest(self, side: Side) -> list[float]:
        """Angles of an arm's five joints at rest, rad."""
        return [self._rest[name] for name in arm_joints(side)]

    def move(self, side: Side, angles: Array) -> None:
        """Sets the targets of an arm's five joints, rad."""
        self._drive(self.arms[side].joints, angles.tolist())

    def grip(self, side: Side, opening: float) -> None:
        """Sets how far each jaw is to be from the middle of the hand, m."""
        self._drive(self.arms[side].jaws, [opening, opening])

    def head_pose(self) -> Frame:
        """The head's frame, in which NAO's documentation places the cameras."""
        return self.frame(self.joints["HeadPitch"])

    def frame(self, link: int) -> Frame:
        """A link's frame in the world, as the description defines it."""
        state = self.client.getLinkState(self.body, link, computeForwardKinematics=1)
        return state[4], state[5]

    def torques(self) -> dict[str, float]:
        """What the motors of both arms' joints exert now, by name, Nm."""
        names = [name for side in SIDES for name in arm_joints(side)]
        states = self.client.getJointStates(self.body, [self.joints[name] for name in names])
        return {name: float(state[3]) for name, state in zip(names, states, strict=True)}

    def _drive(self, joints: Sequence[int], targets: Sequence[float]) -> None:
        self.client.setJointMotorControlArray(
            self.body,
            joints,
            self.client.POSITION_CONTROL,
            targetPositions=targets,
            forces=[self._efforts[joint] for joint in joints],
        )

    def _arm(self, description: str, infos: list[Any], side: Side) -> Arm:
        jaws = tuple(self.joints[name] for name in jaw_joints(side))
        gripper = int(infos[jaws[0]][16])
        tip = infos[gripper][12].decode()
        chain = KinematicChain(description, tip, (0.0, 0.0, TORSO_HEIGHT))
        if chain.joints != arm_joints(side):
            raise ValueError(
                f"the joints from the torso to {tip} must be {', '.join(arm_joints(side))}, "
                f"got {', '.join(chain.joints)}"
            )
        return Arm(chain, tuple(self.joints[name] for name in chain.joints), gripper, jaws)


def _read(path: str) -> str:
    """The text of a description that has all joints.

    Raises:
        ValueError: If it cannot be read, is no XML, lacks a joint, or falls into several parts.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"cannot read a robot from {path}: it is a folder, device or pipe")
    try:
        with open(path, encoding="utf-8") as file:
            description = file.read()
        root = ElementTree.fromstring(description)
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        reason = error.strerror if isinstance(error, OSError) else f"it is no URDF ({error})"
        raise ValueError(f"cannot read a robot from {path}: {reason}") from error
    joints = root.findall("joint")
    kinds = {joint.get("name"): joint.get("type") for joint in joints}
    needed = dict.fromkeys(HEAD_JOINTS, "revolute")
    for side in SIDES:
        needed |= dict.fromkeys(arm_joints(side), "revolute")
        needed |= dict.fromkeys(jaw_joints(side), "prismatic")
    missing = [f"{name} ({kind})" for name, kind in needed.items() if kinds.get(name) != kind]
    if missing:
        raise ValueError(
            f"the robot in {path} lacks the joints {', '.join(missing)}; add them, or leave the "
            "path out for the project's own robot"
        )
    carried = {child.get("link") for joint in joints for child in joint.iter("child")}
    roots = [str(link.get("name")) for link in root.findall("link")]
    roots = [name for name in roots if name not in carried]
    if len(roots) != 1:  # Bullet would end the process
        raise ValueError(
            f"the robot in {path} must have one root link, the torso, got {', '.join(roots)}"
        )
    return description


def _load(client: BulletClient, description: str, path: str | None) -> int:
    """Stands a robot at its place; a description without a path goes through a temporary file."""
    with tempfile.TemporaryDirectory() as folder:  # Bullet reads descriptions from files only
        if path is None:
            path = os.path.join(folder, "nao.urdf")
            with open(path, "w", encoding="utf-8") as file:
                file.write(description)
        try:
            body = client.loadURDF(
                path,
                [0.0, 0.0, TORSO_HEIGHT],
                useFixedBase=True,
                flags=client.URDF_USE_INERTIA_FROM_FILE | client.URDF_MAINTAIN_LINK_ORDER,
            )
        except client.error as error:
            raise ValueError(f"Bullet cannot load the robot in {path}: {error}") from error
    return int(body)
