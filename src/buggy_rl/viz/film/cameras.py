"""Cameras: chase, top and fixed."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Kind = Literal["chase", "top", "fixed"]
CHASE = (1.0, -24.0, 0.05)  # [m] behind the car, [deg] downwards, [m] above the floor looked at
FOLLOWING = 0.35  # [s] time constant with which the chase camera turns after the car
FIXED = (-32.0, 125.0)  # [deg] downwards, compass direction that a fixed camera looks in
FIELD = 45.0  # [deg] vertical field of view, MuJoCo's own
MARGIN = 1.15  # of the room that top and fixed cameras leave about the tracks
LEAST = 0.8  # [m] half height of what they show at least


@dataclass(frozen=True)
class View:
    """Where a camera looks, in MuJoCo's angles."""

    lookat: tuple[float, float, float]
    """[m]"""
    distance: float
    """[m]"""
    azimuth: float
    """[deg] compass direction that it looks in, 0 along x."""
    elevation: float
    """[deg] above the horizon."""


def views(
    kind: Kind, poses: NDArray, everything: Sequence[NDArray], fps: float, aspect: float
) -> list[View]:
    """A view for each frame.

    Args:
        kind: chase follows the first car; top and fixed stand where they see all tracks.
        poses: [N, 3] of the first car.
        everything: Points [M, 2] that top and fixed cameras keep in sight.
        fps: Frames a second.
        aspect: Width over height.

    Raises:
        ValueError: There is no such camera.
    """
    if kind not in get_args(Kind):
        raise ValueError(f"no camera {kind!r}; available: {', '.join(get_args(Kind))}")
    if kind == "chase":
        distance, elevation, height = CHASE
        turned = followed(poses[:, 2], FOLLOWING * fps)
        return [
            View((float(x), float(y), height), distance, float(np.degrees(yaw)), elevation)
            for (x, y, _), yaw in zip(poses, turned, strict=True)
        ]
    points = np.concatenate(everything)
    low, high = points.min(0), points.max(0)
    middle, reach = (low + high) / 2, (high - low) / 2
    half = MARGIN * max(LEAST, reach[1], reach[0] / aspect)
    elevation, azimuth = (-90.0, 90.0) if kind == "top" else FIXED
    distance = half / np.tan(np.radians(FIELD / 2))
    view = View((float(middle[0]), float(middle[1]), 0.0), float(distance), azimuth, elevation)
    return [view] * len(poses)


def followed(angle: NDArray, frames: float) -> NDArray:
    """An unwrapped angle [N] behind a low pass of a time constant in frames."""
    share = 1.0 if frames <= 0 else 1.0 - np.exp(-1.0 / frames)
    result = np.empty_like(angle)
    last = angle[0]
    for index, value in enumerate(angle):
        last = result[index] = last + share * (value - last)
    return result
