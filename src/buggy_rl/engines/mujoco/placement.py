"""Conversion between qpos, qvel of MuJoCo and pose, velocity.

Rows are environments. `park`, `place` and `set_off` write into the arrays they are given.
"""

import numpy as np
from numpy.typing import NDArray

from buggy_rl.engines.mujoco.car import Car
from buggy_rl.engines.mujoco.forces import read_motion


def seen_pose(qpos: NDArray, last_yaw: NDArray) -> NDArray:
    """Pose [n, 3]; the yaw goes on from `last_yaw` [n], not wrapped."""
    w, x, y, z = qpos[:, 3:7].T
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    turns = np.round((last_yaw - yaw) / (2 * np.pi))
    return np.stack([qpos[:, 0], qpos[:, 1], yaw + 2 * np.pi * turns], -1)


def seen_velocity(qpos: NDArray, qvel: NDArray) -> NDArray:
    """Velocity [n, 3] of the body frame along and across the heading, and yaw rate."""
    motion = read_motion(qpos, qvel)
    return np.stack([motion.vx, motion.vy, motion.yaw_rate], -1)


def park(car: Car, qpos: NDArray, qvel: NDArray) -> None:
    """Puts cars at rest at the origin, springs settled, heading along x."""
    qpos[:] = car.parked
    qvel[:] = 0.0


def place(qpos: NDArray, qvel: NDArray, pose: NDArray) -> None:
    """Moves cars to `pose` [n, 3]; pitch, roll and the body-frame velocity stay."""
    qpos[:, :2] = pose[:, :2]
    turn = pose[:, 2] - seen_pose(qpos, pose[:, 2])[:, 2]
    cos, sin = np.cos(turn), np.sin(turn)
    vx, vy = qvel[:, 0].copy(), qvel[:, 1].copy()
    qvel[:, 0], qvel[:, 1] = cos * vx - sin * vy, sin * vx + cos * vy
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    w, x, y, z = qpos[:, 3:7].T.copy()
    # (c, 0, 0, s) * (w, x, y, z): a turn about the world's vertical
    qpos[:, 3], qpos[:, 4] = c * w - s * z, c * x - s * y
    qpos[:, 5], qpos[:, 6] = c * y + s * x, c * z + s * w


def set_off(car: Car, qpos: NDArray, qvel: NDArray, velocity: NDArray) -> None:
    """Gives cars a `velocity` [n, 3]; wheel speeds change with it, so that the slip stays."""
    change = velocity - seen_velocity(qpos, qvel)  # (n, 3) vx, vy, yaw_rate
    motion = read_motion(qpos, qvel)
    qvel[:, 0] += motion.cos * change[:, 0] - motion.sin * change[:, 1]
    qvel[:, 1] += motion.sin * change[:, 0] + motion.cos * change[:, 1]
    # The vertical axis in the body frame.
    w, x, y, z = qpos[:, 3:7].T
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)
    qvel[:, 3:6] += up * change[:, 2:]
    steering = np.zeros((4, len(qpos)))
    steering[:2] = qpos[:, car.steer + 1].T
    patch_x = change[:, 0] - change[:, 2] * car.hub_y  # (4, n)
    patch_y = change[:, 1] + change[:, 2] * car.hub_x
    rolling = np.cos(steering) * patch_x + np.sin(steering) * patch_y
    qvel[:, car.spin] += rolling.T / car.dimensions.wheel_radius
