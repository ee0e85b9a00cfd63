"""Everything that one frame shows, as plain numbers: what every renderer and viewer consumes."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[Any]
"""[K, 2] x, y [m], world frame."""

Frame = NDArray[np.uint8]
"""[H, W, 3] red, green, blue."""

NO_POINTS: Points = np.zeros((0, 2))


@dataclass(frozen=True)
class ShownCar:
    """One car at one instant."""

    name: str
    """Name in the legend."""
    x: float
    """Position of the reference point, the tracking sensor, along x [m]."""
    y: float
    """[m]"""
    yaw: float
    """[rad]"""
    speed: float
    """vx [m/s]."""
    throttle: float
    """Command, -1 is no drive."""
    steering: float
    """Command, +1 is full left."""
    steering_angle: float
    """Angle of the front wheels [rad], positive to the left."""
    roll: NDArray[Any]
    """[4] angle of each wheel about its axle [rad], in the order of `wheels.PLACES`."""
    trail: Points = field(default_factory=lambda: NO_POINTS)
    """Points where the car was, oldest first."""


@dataclass(frozen=True)
class View:
    """Viewpoint of a picture, as MuJoCo's free camera says it."""

    x: float
    """Position of the point looked at, along x [m]."""
    y: float
    """[m]"""
    z: float
    """[m]"""
    distance: float
    """Distance from the camera to that point [m]."""
    azimuth: float
    """Direction of view about the vertical [rad]; 0 looks along x."""
    elevation: float
    """Elevation of the direction of view [rad]; -pi/2 looks straight down."""


@dataclass(frozen=True)
class Shot:
    """One frame."""

    time: float
    """Time since the track began [s]."""
    view: View
    car: ShownCar
    ghosts: tuple[ShownCar, ...] = ()
    """Further trajectories, translucent; two at most."""
    ahead: Points = field(default_factory=lambda: NO_POINTS)
    """The path ahead, nearest first."""
    waypoints: Points = field(default_factory=lambda: NO_POINTS)
    """Waypoints of the path, those near the car."""
    closed_for: NDArray[Any] = field(default_factory=lambda: np.zeros(0))
    """[K] since each waypoint was closed [s]; below 0 it is open."""

    @property
    def cars(self) -> list[ShownCar]:
        """The car, then the ghosts."""
        return [self.car, *self.ghosts]
