"""Where a hand is for given joint angles, and which angles bring it somewhere."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLANT_WEIGHT = 0.01
"""m that 1 rad of slant counts for: where both cannot be had, the place comes first."""
DAMPING = 3e-4
"""λ of the damped least squares, in the error's unit (m and rad) per rad."""
LARGEST_STEP = 0.5
"""Largest change of an angle in one iteration, rad."""
TOLERANCE = 1e-7
"""Error at which the iterations stop, m and rad."""


@dataclass(frozen=True)
class Solution:
    """Angles found for a sequence of places.

    Attributes:
        angles: (N, joints), rad.
        distance: How far the hand stays from each place, (N,), m.
        slant: How far the hand's forward and sideways axes rise out of the horizontal, the larger
            of the two, (N,), rad.
        iterations: How many were taken.
    """

    angles: Array
    distance: Array
    slant: Array
    iterations: int


class KinematicChain:
    """A serial chain of revolute joints from the root of a URDF to one of its links.

    Rigid motions are (4, 4) matrices; the root's frame is the world's, moved by `base`.

    Args:
        description: The URDF's text.
        tip: Name of the last link.
        base: Position of the root link in the world, (3,), m.

    Attributes:
        joints: Names of the chain's moving joints, from the root on; J of them.
        lower: Lower limits, (J,), rad.
        upper: Upper limits, (J,), rad.
        root: Place of the first joint in the world, (3,), m.

    Raises:
        ValueError: If there is no such link, or a joint on the way neither turns nor is fixed.
    """

    def __init__(self, description: str, tip: str, base: tuple[float, float, float]) -> None:
        carriers = {
            child.get("link", ""): joint
            for joint in ElementTree.fromstring(description).findall("joint")
            for child in joint.iter("child")
        }
        if tip not in carriers:
            raise ValueError(f"the robot has no link {tip}")
        path: list[ElementTree.Element] = []
        while tip in carriers:
            path.insert(0, carriers[tip])
            tip = next(path[0].iter("parent")).get("link", "")
        start = np.eye(4)
        start[:3, 3] = base
        fixed, names, axes, limits = [start], [], [], []
        for joint in path:
            fixed[-1] = fixed[-1] @ _origin(joint)
            kind = joint.get("type")
            if kind == "fixed":
                continue
            if kind != "revolute":
                raise ValueError(f"joint {joint.get('name')} must be revolute or fixed, got {kind}")
            limit = next(joint.iter("limit"))
            names.append(joint.get("name", ""))
            axes.append(_numbers(joint.find("axis"), "xyz", "1 0 0"))
            limits.append([float(limit.get(key, 0)) for key in ("lower", "upper")])
            fixed.append(np.eye(4))
        self.joints = tuple(names)
        self.lower, self.upper = np.array(limits).reshape(-1, 2).T
        self.root = fixed[0][:3, 3]
        self._fixed = np.array(fixed)  # (J + 1, 4, 4): before each joint, and after the last
        self._axes = np.array(axes).reshape(-1, 3)
        lengths = np.linalg.norm(self._axes, axis=1, keepdims=True)
        if not (lengths > 0).all():
            still = [name for name, size in zip(self.joints, lengths, strict=True) if not size > 0]
            raise ValueError(f"the joints {', '.join(still)} have no axis to turn about")
        self._axes /= lengths
        self._cross = np.zeros((len(axes), 3, 3))  # [a]ₓ, so that [a]ₓ v = a × v
        for (x, y, z), cross in zip(self._axes, self._cross, strict=True):
            cross[:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]

    def forward(self, angles: Array) -> Array:
        """The tip's frame in the world, (N, 4, 4), for angles (N, J)."""
        return self._frames(angles)[-1]

    def level(self, places: Array, start: Array, most: int = 100) -> Solution:
        """Angles that bring the tip to places with its x and y axes horizontal.

        Damped least squares, Δq = Jᵀ(JJᵀ + λ²I)⁻¹e, on five errors: the three coordinates of the
        tip, m, and the vertical components of its x and y axes, which are sin of their slant; the
        turn about the vertical stays free. Angles are held within the limits.

        Args:
            places: (N, 3), m, in the world.
            start: Angles to start all places from, (J,), rad.
            most: Iterations after which to give up; the solution says how far it came.
        """
        angles = np.tile(start, (len(places), 1))
        weights = np.array([1.0, 1.0, 1.0, SLANT_WEIGHT, SLANT_WEIGHT])
        for iteration in range(most + 1):
            frames = self._frames(angles)
            tip = frames[-1]
            error = np.concatenate([places - tip[:, :3, 3], -tip[:, 2, :2]], axis=1)
            if iteration == most:
                break
            slope = self._slope(frames) * weights[:, None]
            wish = (error * weights)[:, :, None]
            step = _damped(slope, wish)
            # A joint at its limit that wants to go on stays where it is; the others make up for it.
            stuck = ((angles <= self.lower) & (step < 0)) | ((angles >= self.upper) & (step > 0))
            if stuck.any():
                step = _damped(np.where(stuck[:, None], 0.0, slope), wish)
            step *= np.minimum(1, LARGEST_STEP / np.abs(step).max(axis=1, keepdims=True))
            last, angles = angles, np.clip(angles + step, self.lower, self.upper)
            if np.abs(angles - last).max() < TOLERANCE:
                break
        distance = np.linalg.norm(error[:, :3], axis=1)
        slant = np.arcsin(np.abs(error[:, 3:]).max(axis=1).clip(max=1))
        return Solution(angles, distance, slant, iteration)

    def _frames(self, angles: Array) -> list[Array]:
        """Frames of all joints, after their turn, and of the tip; J + 1 of (N, 4, 4)."""
        sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
        turns = np.zeros((*angles.shape, 4, 4))
        # Rodrigues: R = I + sin q [a]ₓ + (1 − cos q) [a]ₓ².
        turns[..., :3, :3] = (
            np.eye(3) + sine * self._cross + (1 - cosine) * (self._cross @ self._cross)
        )
        turns[..., 3, 3] = 1
        frames = []
        frame = np.tile(np.eye(4), (len(angles), 1, 1))
        for i in range(angles.shape[1]):
            frame = frame @ self._fixed[i] @ turns[:, i]
            frames.append(frame)
        return [*frames, frame @ self._fixed[-1]]

    def _slope(self, frames: list[Array]) -> Array:
        """Jacobian of the coordinates of the tip and the heights of its axes, (N, 5, J).

        A turn about a world axis w through o moves a point p by w × (p − o) and a direction d by
        w × d.
        """
        joints, tip = np.stack(frames[:-1], axis=1), frames[-1]
        axes = np.einsum("njab,jb->nja", joints[:, :, :3, :3], self._axes)
        moved = np.cross(axes, tip[:, None, :3, 3] - joints[:, :, :3, 3])
        # Height of w × d: w_x d_y − w_y d_x.
        heights = (
            axes[:, :, 0, None] * tip[:, None, 1, :2] - axes[:, :, 1, None] * tip[:, None, 0, :2]
        )
        return np.concatenate([moved, heights], axis=2).transpose(0, 2, 1)


def _damped(slope: Array, wish: Array) -> Array:
    """Jᵀ(JJᵀ + λ²I)⁻¹e for a batch, (N, J)."""
    turned = slope.transpose(0, 2, 1)
    square = slope @ turned + DAMPING**2 * np.eye(slope.shape[1])
    step: Array = (turned @ np.linalg.solve(square, wish))[:, :, 0]
    return step


def _origin(joint: ElementTree.Element) -> Array:
    """A joint's frame in its parent's, (4, 4); roll, pitch and yaw are about the parent's axes."""
    origin = joint.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0")
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    frame = np.eye(4)
    frame[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    frame[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return frame


def _numbers(element: ElementTree.Element | None, key: str, default: str) -> Array:
    text = default if element is None else element.get(key, default)
    return np.array([float(word) for word in text.split()])
