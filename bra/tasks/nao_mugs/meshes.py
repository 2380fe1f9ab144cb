"""Surfaces through rings of points, as text of Wavefront OBJ files: finer looks than primitives."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


def loft(rings: Sequence[Points]) -> str:
    """Joins neighbouring rings by strips; smooth around the rings, sharp where strips meet.

    Args:
        rings: Closed rings of n points each, (n, 3); counter-clockwise seen from the last ring
            puts the outside outside. A ring may shrink to a point to close the surface.

    Returns:
        Text of an OBJ file.
    """
    count = len(rings[0])
    points: list[str] = []
    normals: list[str] = []
    faces: list[str] = []
    for strip, (start, end) in enumerate(pairwise(rings)):
        middle = start + end
        around = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
        outward = np.cross(around, end - start)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        points += [f"v {x} {y} {z}" for x, y, z in np.concatenate([start, end])]
        normals += [f"vn {x} {y} {z}" for x, y, z in outward]
        for here in range(count):
            there = (here + 1) % count
            for corners in (
                (here, there, count + there),
                (here, count + there, count + here),
            ):
                faces.append(
                    "f "
                    + " ".join(
                        f"{2 * count * strip + corner + 1}//{count * strip + corner % count + 1}"
                        for corner in corners
                    )
                )
    return "\n".join([*points, *normals, *faces, ""])


def lathe(profile: Sequence[tuple[float, float]], segments: int = 20) -> str:
    """A surface of revolution about z.

    Args:
        profile: (radius, z) from point to point; the outside is on the right of the way when
            z points up and the radius to the right.
        segments: Corners of a ring.
    """
    angle = 2 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(segments)], axis=-1)
    return loft([radius * circle + np.array([0.0, 0.0, z]) for radius, z in profile])


def tube(path: Sequence[tuple[float, float]], radius: float, segments: int = 6) -> str:
    """A round tube along a path in the plane x = 0, mitred at the corners.

    Args:
        path: (y, z) from point to point, without turning back.
        radius: Of the tube.
        segments: Corners of a ring.
    """
    points = np.array([(0.0, y, z) for y, z in path])
    ways = np.diff(points, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(segments)[:, None] / segments
    sideways = np.array([1.0, 0.0, 0.0])
    rings = []
    for point, before, after in zip(points, [ways[0], *ways], [*ways, ways[-1]], strict=True):
        ahead = (before + after) / np.linalg.norm(before + after)
        # A slanted cut through a tube is an ellipse.
        across = np.cross(ahead, sideways) / (ahead @ after)
        rings.append(point + radius * (np.cos(angle) * sideways + np.sin(angle) * across))
    return loft(rings)
