"""Steering and rolling of the four wheels, from the motion of the body and the command."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions

PLACES = ("front_left", "front_right", "rear_left", "rear_right")
FULL_LOCK = 0.36  # [rad] of the road wheels at steering 1; mean of DART's 0.32 left and 0.40 right


def places(dimensions: VehicleDimensions) -> NDArray[Any]:
    """[4, 2] wheel centres in the body frame: x ahead of the tracking sensor, y to the left [m]."""
    front = dimensions.cg_to_front_axle - dimensions.sensor_to_cg
    rear, left = front - dimensions.wheelbase, dimensions.track_width / 2
    return np.array([[front, left], [front, -left], [rear, left], [rear, -left]])


def steering_angle(steering: NDArray[Any], full_lock: float = FULL_LOCK):
    """Angle of the front wheels [rad] for a command in [-1, 1], both positive to the left."""
    return full_lock * np.clip(steering, -1.0, 1.0)


def spin(
    velocity: NDArray[Any], angle: NDArray[Any], dimensions: VehicleDimensions
) -> NDArray[Any]:
    """Wheel speeds [*, 4] in rad/s of wheels that roll without longitudinal slip.

    omega = ((vx - r y) cos(delta) + (vy + r x) sin(delta)) / R,  delta = 0 at the rear.

    Args:
        velocity: [*, 3] vx, vy [m/s], yaw_rate [rad/s], body frame.
        angle: [*] of the front wheels [rad].
        dimensions: Of the car.
    """
    vx, vy, yaw_rate = (part[..., None] for part in np.moveaxis(velocity, -1, 0))
    x, y = places(dimensions).T  # (4,)
    turned = angle[..., None] * np.array([1.0, 1.0, 0.0, 0.0])
    along = (vx - yaw_rate * y) * np.cos(turned) + (vy + yaw_rate * x) * np.sin(turned)
    return along / dimensions.wheel_radius


def rolled(
    time: NDArray[Any],
    velocity: NDArray[Any],
    angle: NDArray[Any],
    dimensions: VehicleDimensions,
) -> NDArray[Any]:
    """Roll angles [T, 4] in rad of each wheel since the first row, by the trapezoidal rule.

    Args:
        time: [T] s.
        velocity: [T, 3] body frame.
        angle: [T] of the front wheels [rad].
        dimensions: Of the car.
    """
    omega = spin(velocity, angle, dimensions)  # (T, 4)
    turned = 0.5 * (omega[1:] + omega[:-1]) * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, 4)), turned.cumsum(0)])
