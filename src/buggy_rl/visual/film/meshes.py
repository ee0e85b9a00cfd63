"""Vertices and faces of the car's parts, in the part's own frame: x forward, y left, z up."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Section = tuple[float, float, float, float, float]
"""x, half width at the foot, half width at the top, z of the foot, z of the top [m]."""


def hull(sections: Sequence[Section]) -> NDArray[Any]:
    """Corners [4 S, 3] of a convex part, symmetric about the xz plane, from its cross sections."""
    corners = []
    for x, foot, top, low, high in sections:
        corners += [(x, foot, low), (x, -foot, low), (x, top, high), (x, -top, high)]
    return np.array(corners)


def revolved(
    profile: Sequence[tuple[float, float]], sides: int, lugs: float = 0.0
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A closed body of revolution about the y axis.

    Args:
        profile: y and radius [m], from one end to the other; both ends are closed by a disc.
        sides: Of its outline; even where there are lugs.
        lugs: Share by which every second side of the largest radius stands out.

    Returns:
        Vertices [V, 3], and faces [F, 3] that are counterclockwise seen from outside.
    """
    y, radius = np.array(profile).T  # (P,)
    angle = 2 * np.pi * np.arange(sides) / sides
    swell = np.ones((len(y), sides))
    swell[np.isclose(radius, radius.max())] += lugs * (np.arange(sides) % 2)
    ring = radius[:, None] * swell  # (P, sides)
    x, z = ring * np.cos(angle), ring * np.sin(angle)
    tube = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], -1).reshape(-1, 3)
    ends = np.array([[0.0, y[0], 0.0], [0.0, y[-1], 0.0]])
    side = np.arange(sides)
    after = (side + 1) % sides
    faces = []
    for row in range(len(y) - 1):
        a, b = row * sides + side, row * sides + after
        c, d = a + sides, b + sides
        faces += [np.stack([a, c, b], 1), np.stack([b, c, d], 1)]
    first, last = len(tube), len(tube) + 1
    tail = (len(y) - 1) * sides
    faces.append(np.stack([np.full(sides, first), side, after], 1))
    faces.append(np.stack([np.full(sides, last), tail + after, tail + side], 1))
    return np.concatenate([tube, ends]), np.concatenate(faces)
