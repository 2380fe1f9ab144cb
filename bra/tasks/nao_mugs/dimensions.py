"""NAO V5 in numbers: where its joints sit, how far they turn, how strong and heavy it is.

Lengths in m, angles in rad, masses in kg, efforts in Nm (N for the jaws), velocities in rad/s
(m/s for the jaws); x points forward, y left, z up. Sources: Aldebaran documentation 2.x (links,
joints, motors, masses, video camera) and the ROS package nao_description, V5.0.
"""

from dataclasses import dataclass

Vector = tuple[float, float, float]

TORSO_HEIGHT = 0.333  # of the torso's frame above the floor, standing
JAW_OPENING = 0.018  # of each jaw, from the middle of the hand to its inner face
JAW_FORCE = 6.0  # N, of each jaw

HEAD_JOINTS = ("HeadYaw", "HeadPitch")
ARM_JOINTS = ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw")
JAW_JOINTS = ("Finger", "Thumb")
PREFIX = {"left": "L", "right": "R"}
"""What NAO's names of joints and links begin with on either side."""

REST = {
    "HeadYaw": 0.0,
    "HeadPitch": 0.0,
    "ShoulderPitch": 1.62,
    "ShoulderRoll": 0.12,
    "ElbowYaw": -1.2,
    "ElbowRoll": -0.40,
    "WristYaw": 0.0,
}
"""The posture at rest: arms at the sides. Joints of the left arm, the right one is its mirror
image; joints that are missing here rest at 0."""


@dataclass(frozen=True)
class Joint:
    """A joint and the link that it carries.

    Attributes:
        name: Its name; "?" stands for the side.
        parent: Link that carries it.
        child: Link that it carries.
        origin: Its place in the parent's frame; left side.
        axis: About which it turns or along which it slides; zero if it is fixed. Left side.
        lower: Lower limit of the left side.
        upper: Upper limit of the left side.
        effort: Largest torque, or force.
        velocity: Largest velocity.
        mass: Of the child link.
        centre: Centre of the child's mass in its frame; left side.
        slides: Whether it is prismatic.
    """

    name: str
    parent: str
    child: str
    origin: Vector
    axis: Vector
    lower: float
    upper: float
    effort: float
    velocity: float
    mass: float
    centre: Vector
    slides: bool = False


X, Y, Z, FIXED = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

TORSO_MASS = 1.0496
HEAD = (
    Joint(
        "HeadYaw", "torso", "Neck", (0, 0, 0.1265), Z, -2.0857, 2.0857, 1.547, 8.27, 0.0784,
        (0, 0, -0.027),
    ),
    Joint(
        "HeadPitch", "Neck", "Head", (0, 0, 0), Y, -0.6720, 0.5149, 1.532, 7.19, 0.6053,
        (0, 0, 0.053),
    ),
)  # fmt: skip
# The wrist's and the hand's 0.1853 kg together are those of wrist, gripper and both jaws here.
ARM = (
    Joint(
        "?ShoulderPitch", "torso", "?Shoulder", (0, 0.098, 0.100), Y, -2.0857, 2.0857, 1.329, 8.27,
        0.0930, (0, 0, 0),
    ),
    Joint(
        "?ShoulderRoll", "?Shoulder", "?Bicep", (0, 0, 0), Z, -0.3142, 1.3265, 1.78, 7.19,
        0.1578, (0.025, 0.006, 0),
    ),
    Joint(
        "?ElbowYaw", "?Bicep", "?Elbow", (0.105, 0.015, 0), X, -2.0857, 2.0857, 1.547, 8.27,
        0.0648, (-0.026, 0, 0),
    ),
    Joint(
        "?ElbowRoll", "?Elbow", "?ForeArm", (0, 0, 0), Z, -1.5446, -0.0349, 1.532, 7.19,
        0.0776, (0.025, 0, 0),
    ),
    Joint(
        "?WristYaw", "?ForeArm", "?Wrist", (0.05595, 0, 0), X, -1.8238, 1.8238, 0.4075, 24.6,
        0.0853, (0.010, 0, 0),
    ),
    Joint(
        "?Hand", "?Wrist", "?Gripper", (0.05775, 0, -0.01231), FIXED, 0, 0, 0, 0,
        0.0600, (-0.022, 0, 0),
    ),
    Joint(
        "?Finger", "?Gripper", "?FingerJaw", (0, 0, 0), Y, 0, JAW_OPENING, JAW_FORCE, 0.2,
        0.0200, (0, 0, 0), slides=True,
    ),
    Joint(
        "?Thumb", "?Gripper", "?ThumbJaw", (0, 0, 0), (0, -1.0, 0), 0, JAW_OPENING, JAW_FORCE, 0.2,
        0.0200, (0, 0, 0), slides=True,
    ),
)  # fmt: skip
# A leg stands still and is one link, at the hip: pelvis, hip, thigh, tibia, ankle and foot.
LEG = (
    Joint(
        "?Leg", "torso", "?Leg", (0, 0.050, -0.085), FIXED, 0, 0, 0, 0,
        0.0698 + 0.1405 + 0.3897 + 0.3014 + 0.1342 + 0.1718, (0, 0, -0.100),
    ),
)  # fmt: skip
THIGH, TIBIA, FOOT_HEIGHT = 0.100, 0.1029, 0.04519

BOTTOM_CAMERA = ((0.05071, 0.0, 0.01774), 0.6929)
TOP_CAMERA = ((0.05871, 0.0, 0.06364), 0.0209)
"""Places in the head's frame, and pitch downwards."""


def arm_joints(side: str) -> tuple[str, ...]:
    """Names of an arm's five joints, from the shoulder to the wrist."""
    return tuple(PREFIX[side] + name for name in ARM_JOINTS)


def jaw_joints(side: str) -> tuple[str, ...]:
    """Names of the joints of a hand's two jaws."""
    return tuple(PREFIX[side] + name for name in JAW_JOINTS)


def mirrored(joint: Joint, side: str) -> Joint:
    """A joint of the table on either side of the body.

    The right arm is the left one's mirror image about y = 0: places change the sign of y, and
    turns about x and z their sense, so that their limits swap.
    """
    name, parent, child = (
        text.replace("?", PREFIX[side]) for text in (joint.name, joint.parent, joint.child)
    )
    values = vars(joint) | {"name": name, "parent": parent, "child": child}
    if side == "right":
        flip = 1.0, -1.0, 1.0
        values["origin"] = _times(joint.origin, flip)
        values["centre"] = _times(joint.centre, flip)
        if joint.slides:
            values["axis"] = _times(joint.axis, flip)
        elif joint.axis in (X, Z):
            values["lower"], values["upper"] = -joint.upper, -joint.lower
    return Joint(**values)


def rest_posture() -> dict[str, float]:
    """The posture at rest by joint, both arms and the head."""
    posture = {name: REST[name] for name in HEAD_JOINTS}
    for name in ARM_JOINTS:
        posture["L" + name] = REST[name]
        posture["R" + name] = REST[name] if name == "ShoulderPitch" else -REST[name]
    return posture


def _times(vector: Vector, factors: Vector) -> Vector:
    x, y, z = (a * b for a, b in zip(vector, factors, strict=True))
    return x, y, z
