"""A step of the motion with an acceleration added, in calls that can be compiled.

Each is some twenty operations on a few hundred cars, and stands in every effect on the motion:
compiled they take a tenth of the time (`benchmarks/kernels.py`).
"""

import torch
from torch import Tensor

from buggy_rl.kernels.kernel import Kernel
from buggy_rl.vehicle import columns, integrate_pose, shift_velocity


def centred(numbers: Tensor, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """Velocities of the centre of gravity.

    Args:
        numbers: [2] distance of the sensor ahead of it [m], step [s].
        start: [n, 3] velocity at the sensor before the step, body frame.
        end: [n, 3] likewise, after it.

    Returns:
        Both [n, 3] at the centre of gravity.
    """
    arm, _ = numbers.unbind(-1)
    return shift_velocity(start, -arm), shift_velocity(end, -arm)


def mean_acceleration(numbers: Tensor, before: Tensor, after: Tensor) -> tuple[Tensor]:
    """Force over mass and yaw acceleration, means of a step.

    In the body frame of the middle of the step, between whose ends it turns by 2 h = r dt:
    a = (R(h) v' - R(-h) v) / dt, without the apparent forces of a turning frame.

    Args:
        numbers: [1] step [s].
        before: [n, 3] velocity of the centre of gravity, body frame.
        after: [n, 3] likewise.

    Returns:
        [n, 3] ax, ay [m/s^2], yaw acceleration [rad/s^2].
    """
    (dt,) = numbers.unbind(-1)
    (vx, vy, r), (vx_after, vy_after, r_after) = before.unbind(-1), after.unbind(-1)
    h = 0.25 * dt * (r + r_after)
    cos, sin = torch.cos(h), torch.sin(h)
    ax = (cos * vx_after - sin * vy_after) - (cos * vx + sin * vy)
    ay = (sin * vx_after + cos * vy_after) - (cos * vy - sin * vx)
    return (columns(ax / dt, ay / dt, (r_after - r) / dt),)


def moved(
    numbers: Tensor, pose: Tensor, start: Tensor, end: Tensor, change: Tensor, next_pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Pose and velocity after a step whose velocity at the centre of gravity is changed.

    Args:
        numbers: [2] distance of the sensor ahead of the centre of gravity [m], step [s].
        pose: [n, 3] of the sensor before the step.
        start: [n, 3] its velocity before the step.
        end: [n, 3] after it.
        change: [n, 3] of the velocity of the centre of gravity over the step.
        next_pose: [n, 3] of the sensor after the step, without the change.

    Returns:
        Pose and velocity [n, 3] of the sensor after it.
    """
    arm, dt = numbers.unbind(-1)
    changed = end + shift_velocity(change, arm)
    # Both ways begin at x = y = 0: of poses far from there the difference would be rounded.
    yaw = pose[..., 2]
    origin = columns(torch.zeros_like(yaw), torch.zeros_like(yaw), yaw)
    way = integrate_pose(origin, start, changed, dt) - integrate_pose(origin, start, end, dt)
    return next_pose + way, changed


def _rows(count: int, n: int) -> tuple[Tensor, ...]:
    return tuple(torch.tensor([1.0, 0.1, 0.2])[:, None].repeat(1, n).T for _ in range(count))


CENTRED = Kernel("centred", centred, lambda n: (torch.ones(2), *_rows(2, n)), (None, 0, 0))
MEAN_ACCELERATION = Kernel(
    "mean_acceleration", mean_acceleration, lambda n: (torch.ones(1), *_rows(2, n)), (None, 0, 0)
)
MOVED = Kernel("moved", moved, lambda n: (torch.ones(2), *_rows(5, n)), (None, 0, 0, 0, 0, 0))
