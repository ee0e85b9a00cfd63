"""Whether a simulator's pose and velocity are of one motion, by its own steps.

The way of a step is R(yaw) v dt for a velocity in the body frame, v dt for one in the world's, and
R(yaw pi / 180) v dt for a heading in degrees.
"""

import math

from torch import Tensor

from buggy_rl.vehicle import rotate

OFF = 0.2  # [-] of the way driven, beyond which a reading of the axes is wrong,
RIGHT = 0.05  # and within which it is right
TURNED = 0.02  # [rad] of heading, in a run, from which its unit can be told


def axes_fault(pose: Tensor, velocity: Tensor, dt: float) -> str:
    """What is wrong of the axes of runs, and what to do; empty where nothing is.

    Args:
        pose: [B, T, 3] x, y, yaw.
        velocity: [B, T, 3] vx, vy, yaw rate.
        dt: Control period [s].
    """
    way = pose[:, 1:, :2] - pose[:, :-1, :2]
    mean = 0.5 * (velocity[:, 1:, :2] + velocity[:, :-1, :2]) * dt
    yaw = 0.5 * (pose[:, 1:, 2] + pose[:, :-1, 2])
    degree = math.pi / 180
    left = {
        "body": _left(way, rotate(mean, yaw)),
        "world": _left(way, mean),
        "degrees": _left(way, rotate(mean, degree * yaw)),
    }
    turned = (pose[:, -1, 2] - pose[:, 0, 2]).abs()  # (B,)
    rate = 0.5 * (velocity[:, 1:, 2] + velocity[:, :-1, 2])
    by_rate = (rate.sum(1) * dt).abs()
    car = int(by_rate.argmax())
    grown = float(turned[car] / by_rate[car].clamp_min(1e-9))
    in_degrees = float(by_rate[car]) > TURNED and abs(grown * degree - 1) < OFF
    if left["body"] <= OFF and not in_degrees:
        return ""
    if in_degrees or (left["degrees"] < RIGHT and left["degrees"] < left["world"]):
        return (
            f"its heading seems to be in degrees: at a heading of {float(pose[0, 0, 2]):g} a step "
            "moves it along another direction, or the heading changes by other than the yaw rate "
            "says; return yaw in rad and yaw rate in rad/s"
        )
    if left["world"] < RIGHT:
        return (
            "its velocity seems to be the world's: a step moves it along (vx, vy), whatever its "
            "heading is; return vx ahead and vy to the left of the car"
        )
    return ""


def _left(way: Tensor, expected: Tensor) -> float:
    """Root mean square distance over that driven [-]."""
    driven = way.square().sum(-1).mean().clamp_min(1e-12)
    return float(((way - expected).square().sum(-1).mean() / driven).sqrt())
