"""A track: where a car was, row by row, and what there is to draw about it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from buggy_rl.vehicle import VehicleDimensions

FULL_LOCK = 0.36  # [rad] road-wheel angle shown at steering 1; DART's mean of left and right


@dataclass(frozen=True)
class Row:
    """A car at one instant."""

    pose: tuple[float, float, float]
    """x, y [m], yaw [rad]."""
    speed: float
    """vx [m/s]."""
    throttle: float
    steering: float
    wheel_angle: float
    """Of the front wheels [rad], positive left."""
    roll: float
    """Of the wheels [rad], positive forwards."""
    time: float
    """[s]"""
    closed: int = 0
    """Waypoints closed so far."""


@dataclass(frozen=True, eq=False)
class Track:
    """Where a car was."""

    name: str
    """As it is called in the film."""
    time: NDArray
    """[T] s, increasing."""
    pose: NDArray
    """[T, 3] x, y [m], yaw [rad], unwrapped."""
    velocity: NDArray
    """[T, 3] vx, vy [m/s], yaw_rate [rad/s]."""
    action: NDArray
    """[T, 2] throttle, steering in [-1, 1]."""
    waypoints: NDArray | None = None
    """[W, 2] of the path that it was to drive [m]."""
    closed: NDArray | None = None
    """[T] waypoints closed so far."""

    def __post_init__(self) -> None:
        count = len(self.time)
        if count < 2:
            raise ValueError(f"{self.name}: {count} rows are no film: it takes 2 at least")
        for label in ("pose", "velocity", "action"):
            rows = getattr(self, label)
            if len(rows) != count:
                raise ValueError(f"{self.name}: {len(rows)} rows of {label} for {count} of time")
            if not np.isfinite(rows).all():
                bad = int(np.argmin(np.isfinite(rows).all(-1)))
                raise ValueError(
                    f"{self.name}: {label} is no number at {self.time[bad]:.2f} s: end the film "
                    f"before, with seconds={self.time[bad] - self.time[0]:.1f}"
                )

    @property
    def duration(self) -> float:
        """From the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def rolled(self, dimensions: VehicleDimensions) -> NDArray:
        """[T] angle that the wheels have turned, without slip [rad]."""
        step = np.diff(self.time) * 0.5 * (self.velocity[1:, 0] + self.velocity[:-1, 0])
        return np.concatenate([[0.0], np.cumsum(step)]) / dimensions.wheel_radius

    def at(self, times: NDArray, dimensions: VehicleDimensions) -> list[Row]:
        """Rows at times [N] since its beginning; before and after it the car stands still there."""
        own = self.time - self.time[0]

        def read(values: NDArray) -> NDArray:
            return np.interp(times, own, values)

        pose = np.stack([read(column) for column in self.pose.T], -1)
        action = np.stack([read(column) for column in self.action.T], -1)
        roll, speed = read(self.rolled(dimensions)), read(self.velocity[:, 0])
        closed = np.zeros(len(own)) if self.closed is None else self.closed
        row = np.searchsorted(own, times, side="right") - 1
        return [
            Row(
                pose=(float(x), float(y), float(yaw)),
                speed=float(speed[i]),
                throttle=float(action[i, 0]),
                steering=float(action[i, 1]),
                wheel_angle=float(action[i, 1]) * FULL_LOCK,
                roll=float(roll[i]),
                time=float(times[i]),
                closed=int(closed[max(0, row[i])]),
            )
            for i, (x, y, yaw) in enumerate(pose)
        ]
