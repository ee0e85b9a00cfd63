"""Forces of air and floor on a plant over its mass, in the body frame, and friction by place.

Arrays are numpy's, of one shape, or scalars.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from buggy_rl.plants.faults import Faults

FRONT_DRAG = 0.015  # [kg/m] drag over speed squared: 1.2 kg/m^3, c_d = 1, 0.15 m x 0.16 m; chosen
SIDE_AREA = 2.0  # [-] drag from the side over that from the front; chosen
CONTACT_LENGTH = 0.03  # [m] of a tyre, over which its friction changes at the edge; chosen
DRAGGED = 0.1  # [-] share of the one-sided moment that is drag of a wheel; chosen
ROLLING = 0.3  # [m/s] speed at which a dragging wheel is at tanh(1) = 76 % of its force; chosen
Number = Any  # float or array
Moment = Callable[[Number, Number], Number]
Push = Callable[[Number, Number, Number, Number, Number], tuple[Number, Number, Number]]
PUSHES = frozenset(
    ("aerodynamic_drag", "wind", "one_sided_drag", "yaw_damping", "stiff_differential")
)
ALONG_STIFFNESS = 12.5  # [-] longitudinal force of a tyre over load and slip ratio; chosen
LOCKED_GRIP = 0.87  # [-] most of that force over the load; chosen
WALKING = 0.4  # [m/s] speed below which a locked axle's slip ratio grows no further; chosen


def push(
    faults: Faults,
    rolling_share: Number,
    mass: Number,
    yaw_inertia: Number,
    half_track: float,
    rear_load: Number = 0.0,
) -> Push:
    """Builds the function of the forces on a car by its faults.

    Drag: -c |v| v. Wind: a stream W over the car's own way, F = k |w| (w_x, 2 w_y), less that of
    still air, with W from the stated acceleration at rest, mean of front and side. Decelerations
    are of the whole car with its turning wheels, so forces are larger by `rolling_share`.

    Args:
        faults: Of the surroundings.
        rolling_share: Mass of car and turning wheels over that of the car.
        mass: Of the car [kg].
        yaw_inertia: Of the car [kg m^2].
        half_track: Of the car [m].
        rear_load: Of its rear axle [N].

    Returns:
        f(cos, sin, vx, vy, yaw_rate) -> forward and leftward force over mass [m/s^2] and yaw
        acceleration [rad/s^2].
    """
    drag = faults["aerodynamic_drag.coefficient"] * rolling_share
    moment = faults["one_sided_drag.yaw_acceleration"]
    dragging = DRAGGED * abs(moment) * yaw_inertia / (half_track * mass)  # [m/s^2]
    damping = faults["yaw_damping.rate"]
    locked = locked_couple(faults, rear_load, half_track)
    stream = FRONT_DRAG / mass
    wind_x, wind_y = _wind_speed(faults, rolling_share, stream)

    def air(along, across):
        flow = stream * np.hypot(along, across)
        return flow * along, SIDE_AREA * flow * across

    def pushed(cos, sin, vx, vy, yaw_rate):
        speed = np.hypot(vx, vy)
        rolling = np.tanh(vx / ROLLING)
        ax, ay = -(drag * speed * vx + dragging * rolling), -drag * speed * vy
        if "wind" in faults:
            along, across = cos * wind_x + sin * wind_y - vx, cos * wind_y - sin * wind_x - vy
            blown, still = air(along, across), air(-vx, -vy)
            ax, ay = ax + blown[0] - still[0], ay + blown[1] - still[1]
        stiff = locked(vx, yaw_rate) / yaw_inertia
        return ax, ay, moment * rolling - damping * yaw_rate + stiff

    return pushed


def locked_couple(faults: Faults, load: Number, half_track: float) -> Moment:
    """Builds the moment of a stiff rear differential.

    The wheels of a locked axle slip by h r / v, h the half track, one forward and one back:
    M = -q h N f(c h r / (mu v)) mu, f(x) = x / sqrt(1 + x^2), a share q of a locked axle's.

    Args:
        faults: Of the car.
        load: Of the rear axle [N].
        half_track: Of the car [m].

    Returns:
        f(vx, yaw_rate) -> moment [N m].
    """
    share = faults["stiff_differential.coupling"]

    def moment(vx, yaw_rate):
        slip = half_track * yaw_rate / np.maximum(np.abs(vx), WALKING)
        use = ALONG_STIFFNESS / LOCKED_GRIP * slip
        return -share * half_track * load * LOCKED_GRIP * use / np.sqrt(1.0 + use * use)

    return moment


def turned_back(faults: Faults, vx: Number, yaw_rate: Number, ax: Number) -> Number:
    """Angle [rad] by which forces turn the front wheels: a linkage that gives way, and pitch.

    Side force over mass is that of a steady turn, vx yaw_rate; `ax` [m/s^2] is the forward one.
    """
    back = faults["understeer.gradient"] * vx * yaw_rate
    return faults["dive_steer.angle"] * ax - back


def _wind_speed(faults: Faults, rolling_share: Number, stream: Number) -> tuple[Number, Number]:
    """World velocity of the wind [m/s]: m f = k W^2, k the mean of front and side."""
    x, y = faults["wind.force_x"], faults["wind.force_y"]
    size = np.hypot(x, y)
    if size == 0.0:
        return 0.0, 0.0
    speed = np.sqrt(size * rolling_share / (0.5 * (1.0 + SIDE_AREA) * stream))
    return speed * x / size, speed * y / size


def patch_grip(faults: Faults, x, y):
    """Friction at a place (x, y) [m] of the world over that of the floor."""
    distance = np.hypot(x - faults["grip_patch.x"], y - faults["grip_patch.y"])
    inside = (faults["grip_patch.radius"] - distance) / CONTACT_LENGTH + 0.5
    return 1.0 - (1.0 - faults["grip_patch.grip"]) * np.clip(inside, 0.0, 1.0)
