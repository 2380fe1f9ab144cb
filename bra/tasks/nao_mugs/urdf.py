"""Writes NAO as a URDF of primitive shapes: the makers' meshes may not be handed on."""

import math
from dataclasses import dataclass

from bra.tasks.nao_mugs.dimensions import (
    ARM,
    BOTTOM_CAMERA,
    FOOT_HEIGHT,
    HEAD,
    LEG,
    PREFIX,
    THIGH,
    TIBIA,
    TOP_CAMERA,
    TORSO_MASS,
    Joint,
    Vector,
    mirrored,
)

COLOURS = {
    "white": "0.95 0.95 0.97 1",
    "grey": "0.62 0.64 0.68 1",
    "dark": "0.13 0.14 0.17 1",
    "orange": "0.98 0.47 0.06 1",
    "blue": "0.20 0.62 1.00 1",
}
UPRIGHT, ALONG_X, ALONG_Y = (0.0, 0.0, 0.0), (0.0, math.pi / 2, 0.0), (math.pi / 2, 0.0, 0.0)
SOLE = -(THIGH + TIBIA + FOOT_HEIGHT)  # m, the floor in the leg's frame


@dataclass(frozen=True)
class Shell:
    """A primitive shape that a link wears.

    Attributes:
        link: The link; "?" stands for the side.
        size: Radius of a sphere; radius and length of a cylinder or capsule; edges of a box; m.
        place: Its middle in the link's frame, m; left side.
        colour: A name of `COLOURS`; None if it can be touched but not seen.
        angles: Roll, pitch and yaw, rad; cylinders and capsules stand upright at 0. Left side.
        shape: sphere, cylinder, capsule or box.
    """

    link: str
    size: tuple[float, ...]
    place: Vector
    colour: str | None
    angles: Vector = UPRIGHT
    shape: str = ""

    @property
    def kind(self) -> str:
        """The shape, by the count of its sizes if it is not named."""
        return self.shape or ("sphere", "cylinder", "box")[len(self.size) - 1]


def _limb(link: str, radius: float, start: Vector, end: Vector, colour: str) -> tuple[Shell, ...]:
    """A rounded rod along one axis; Bullet draws capsules with pointed ends."""
    axis = next(i for i in range(3) if start[i] != end[i])
    middle = tuple((a + b) / 2 for a, b in zip(start, end, strict=True))
    rod = Shell(
        link,
        (radius, abs(end[axis] - start[axis])),
        (middle[0], middle[1], middle[2]),
        colour,
        (ALONG_X, ALONG_Y, UPRIGHT)[axis],
    )
    return Shell(link, (radius,), start, colour), rod, Shell(link, (radius,), end, colour)


def _disc(link: str, radius: float, place: Vector, colour: str, angles: Vector = ALONG_X) -> Shell:
    return Shell(link, (radius, 0.006), place, colour, angles)


BODY = (
    *_limb("torso", 0.050, (0, -0.030, 0.066), (0, 0.030, 0.066), "white"),
    *_limb("torso", 0.027, (-0.002, -0.062, 0.100), (-0.002, 0.062, 0.100), "white"),
    Shell("torso", (0.052,), (0, 0, 0.020), "white"),
    *_limb("torso", 0.036, (0, -0.030, -0.050), (0, 0.030, -0.050), "grey"),
    _disc("torso", 0.015, (0.0485, 0, 0.064), "grey"),
    _disc("torso", 0.010, (0.0505, 0, 0.064), "blue"),
    Shell("Neck", (0.024, 0.040), (0, 0, -0.010), "grey"),
    *_limb("Head", 0.056, (-0.003, -0.010, 0.0544), (-0.003, 0.010, 0.0544), "white"),
    _disc("Head", 0.006, (TOP_CAMERA[0][0] - 0.006, 0, TOP_CAMERA[0][2]), "dark"),
    # Behind the bottom camera, which would see it otherwise.
    _disc("Head", 0.006, (0.0405, 0, 0.0177), "dark", (0, BOTTOM_CAMERA[1] + math.pi / 2, 0)),
)
PAIRED = (
    _disc("Head", 0.014, (0.0452, 0.027, 0.0520), "grey", (0, math.pi / 2, 0.45)),
    _disc("Head", 0.0115, (0.0462, 0.0275, 0.0520), "blue", (0, math.pi / 2, 0.45)),
    _disc("Head", 0.0070, (0.0472, 0.028, 0.0520), "dark", (0, math.pi / 2, 0.45)),
    Shell("Head", (0.027, 0.010), (-0.006, 0.064, 0.056), "orange", ALONG_Y),
    Shell("Head", (0.017, 0.012), (-0.006, 0.065, 0.056), "grey", ALONG_Y),
    Shell("?Shoulder", (0.034,), (0, 0, 0), "white"),
    _disc("?Shoulder", 0.022, (0, 0.031, 0), "orange", ALONG_Y),
    *_limb("?Bicep", 0.025, (0.030, 0.007, 0), (0.080, 0.012, 0), "white")[1:],
    Shell("?Bicep", (0.0268, 0.014), (0.052, 0.009, 0), "orange", ALONG_X),
    Shell("?Elbow", (0.024,), (0, 0, 0), "grey"),
    *_limb("?ForeArm", 0.024, (0.018, 0, 0), (0.040, 0, 0), "white"),
    Shell("?ForeArm", (0.0258, 0.008), (0.034, 0, 0), "orange", ALONG_X),
    Shell("?Wrist", (0.019, 0.020), (0.008, 0, 0), "grey", ALONG_X),
    *_limb("?Gripper", 0.015, (-0.033, -0.014, 0.003), (-0.033, 0.014, 0.003), "white"),
    Shell("?Gripper", (0.008, 0.050, 0.020), (-0.020, 0, 0), "grey"),
    Shell("?FingerJaw", (0.026, 0.006, 0.020), (-0.004, 0.003, 0), "orange"),
    Shell("?FingerJaw", (0.003, 0.020), (0.009, 0.003, 0), "orange"),
    Shell("?ThumbJaw", (0.026, 0.006, 0.020), (-0.004, -0.003, 0), "orange"),
    Shell("?ThumbJaw", (0.003, 0.020), (0.009, -0.003, 0), "orange"),
    Shell("?Leg", (0.038,), (0, 0, -0.008), "white"),
    *_limb("?Leg", 0.035, (0.002, 0, -0.035), (0.002, 0, -THIGH + 0.015), "white"),
    _disc("?Leg", 0.022, (0.002, 0.034, -0.050), "orange", ALONG_Y),
    Shell("?Leg", (0.030,), (0.004, 0, -THIGH), "grey"),
    *_limb("?Leg", 0.032, (0, 0, -THIGH - 0.035), (0, 0, -THIGH - TIBIA + 0.020), "white"),
    Shell("?Leg", (0.0342, 0.010), (0, 0, -THIGH - 0.040), "orange"),
    Shell("?Leg", (0.110, 0.074, 0.024), (0.015, 0, SOLE + 0.012), "white"),
    Shell("?Leg", (0.037, 0.024), (0.070, 0, SOLE + 0.012), "white"),
    Shell("?Leg", (0.037, 0.024), (-0.040, 0, SOLE + 0.012), "white"),
    Shell("?Leg", (0.034,), (0.005, 0, SOLE + 0.030), "white"),
)
# Only what comes near table and mug can be touched.
SOLID = (
    Shell("?ForeArm", (0.024, 0.022), (0.029, 0, 0), None, ALONG_X, "capsule"),
    Shell("?Gripper", (0.038, 0.050, 0.030), (-0.035, 0, 0.003), None),
    Shell("?FingerJaw", (0.028, 0.006, 0.020), (-0.003, 0.003, 0), None),
    Shell("?ThumbJaw", (0.028, 0.006, 0.020), (-0.003, -0.003, 0), None),
)


def nao_urdf() -> str:
    """NAO V5 as a URDF; the root link "torso" is to be fixed at standing height."""
    shells = [*BODY]
    joints = [*HEAD]
    for side in PREFIX:
        shells += [_mirrored(shell, side) for shell in PAIRED + SOLID]
        joints += [mirrored(joint, side) for joint in ARM + LEG]
    # Bullet's window paints all of a link in the colour of its last shape.
    shells.sort(key=lambda shell: shell.colour == "white")
    links = [("torso", TORSO_MASS, (-0.004, 0.0, 0.043))]
    links += [(joint.child, joint.mass, joint.centre) for joint in joints]
    lines = ['<robot name="nao">']
    lines += [f'  <material name="{n}"><color rgba="{c}"/></material>' for n, c in COLOURS.items()]
    for name, mass, centre in links:
        worn = [_shell(shell) for shell in shells if shell.link == name]
        lines += [f'  <link name="{name}">', _inertial(mass, centre), *worn, "  </link>"]
    lines += [_joint(joint) for joint in joints]
    return "\n".join([*lines, "</robot>", ""])


def _mirrored(shell: Shell, side: str) -> Shell:
    link = shell.link.replace("?", PREFIX[side])
    sign = 1 if side == "left" else -1
    (x, y, z), (roll, pitch, yaw) = shell.place, shell.angles
    place, angles = (x, sign * y, z), (sign * roll, pitch, sign * yaw)
    return Shell(link, shell.size, place, shell.colour, angles, shell.shape)


def _shell(shell: Shell) -> str:
    if shell.kind == "box":
        size = f'size="{_text(shell.size)}"'
    else:
        size = f'radius="{shell.size[0]:g}"'
        size += "".join(f' length="{length:g}"' for length in shell.size[1:])
    tag = "visual" if shell.colour else "collision"
    colour = f'<material name="{shell.colour}"/>' if shell.colour else ""
    return (
        f'    <{tag}><origin xyz="{_text(shell.place)}" rpy="{_text(shell.angles)}"/>'
        f"<geometry><{shell.kind} {size}/></geometry>{colour}</{tag}>"
    )


def _inertial(mass: float, centre: Vector) -> str:
    # The makers' tensors belong to their meshes; a ball of a third of water's density is near
    # enough for arms that follow slow targets.
    radius = (mass / 333 * 3 / (4 * math.pi)) ** (1 / 3)
    moment = 0.4 * mass * radius**2
    return (
        f'    <inertial><origin xyz="{_text(centre)}"/><mass value="{mass:g}"/><inertia '
        f'ixx="{moment:.4g}" iyy="{moment:.4g}" izz="{moment:.4g}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
    )


def _joint(joint: Joint) -> str:
    kind = "prismatic" if joint.slides else "revolute" if any(joint.axis) else "fixed"
    return (
        f'  <joint name="{joint.name}" type="{kind}"><parent link="{joint.parent}"/>'
        f'<child link="{joint.child}"/><origin xyz="{_text(joint.origin)}"/>'
        f'<axis xyz="{_text(joint.axis)}"/><limit lower="{joint.lower:g}" upper="{joint.upper:g}"'
        f' effort="{joint.effort:g}" velocity="{joint.velocity:g}"/></joint>'
    )


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.8g}" for value in values)
