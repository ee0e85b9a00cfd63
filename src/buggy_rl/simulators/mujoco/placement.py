"""Conversion between qpos, qvel of MuJoCo and pose, velocity.

Rows are environments, of NumPy or PyTorch. `park`, `place` and `set_off` write into the arrays they
are given.
"""

import math

from array_api_compat import array_namespace

from buggy_rl.simulators.mujoco.arrays import Array, angle_of
from buggy_rl.simulators.mujoco.car import CompiledCar
from buggy_rl.simulators.mujoco.forces import read_motion


def seen_pose(qpos: Array, last_yaw: Array) -> Array:
    """Pose [n, 3]; the yaw goes on from `last_yaw` [n], not wrapped."""
    xp = array_namespace(qpos)
    w, x, y, z = qpos[:, 3:7].T
    yaw = angle_of(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    turns = xp.round((last_yaw - yaw) / (2 * math.pi))
    return xp.stack([qpos[:, 0], qpos[:, 1], yaw + 2 * math.pi * turns], axis=-1)


def seen_velocity(qpos: Array, qvel: Array) -> Array:
    """Velocity [n, 3] of the body frame along and across the heading, and yaw rate."""
    motion = read_motion(qpos, qvel)
    return array_namespace(qpos).stack([motion.vx, motion.vy, motion.yaw_rate], axis=-1)


def park(car: CompiledCar, qpos: Array, qvel: Array) -> None:
    """Puts cars at rest at the origin, springs settled, heading along x."""
    qpos[:] = car.parked
    qvel[:] = 0.0


def place(qpos: Array, qvel: Array, pose: Array) -> None:
    """Moves cars to `pose` [n, 3]; pitch, roll and the body-frame velocity stay."""
    xp = array_namespace(qpos)
    qpos[:, :2] = pose[:, :2]
    turn = pose[:, 2] - seen_pose(qpos, pose[:, 2])[:, 2]
    cos, sin = xp.cos(turn), xp.sin(turn)
    vx, vy = qvel[:, 0], qvel[:, 1]
    qvel[:, 0], qvel[:, 1] = cos * vx - sin * vy, sin * vx + cos * vy
    c, s = xp.cos(0.5 * turn), xp.sin(0.5 * turn)
    w, x, y, z = qpos[:, 3:7].T
    # (c, 0, 0, s) * (w, x, y, z): a turn about the world's vertical
    turned = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]
    qpos[:, 3:7] = xp.stack(turned, axis=-1)


def set_off(car: CompiledCar, qpos: Array, qvel: Array, velocity: Array) -> None:
    """Gives cars a `velocity` [n, 3]; wheel speeds change with it, so that the slip stays."""
    xp = array_namespace(qpos)
    change = velocity - seen_velocity(qpos, qvel)  # (n, 3) vx, vy, yaw_rate
    motion = read_motion(qpos, qvel)
    qvel[:, 0] += motion.cos * change[:, 0] - motion.sin * change[:, 1]
    qvel[:, 1] += motion.sin * change[:, 0] + motion.cos * change[:, 1]
    # The vertical axis in the body frame.
    w, x, y, z = qpos[:, 3:7].T
    up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    qvel[:, 3:6] += xp.stack(up, axis=-1) * change[:, 2:]
    steered = qpos[:, car.steer + 1].T
    steering = xp.concat([steered, xp.zeros_like(steered)])  # (4, n)
    patch_x = change[:, 0] - change[:, 2] * car.hub_y  # (4, n)
    patch_y = change[:, 1] + change[:, 2] * car.hub_x
    rolling = xp.cos(steering) * patch_x + xp.sin(steering) * patch_y
    qvel[:, car.spin] += rolling.T / car.dimensions.wheel_radius
