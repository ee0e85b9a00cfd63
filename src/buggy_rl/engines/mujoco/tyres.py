"""Explicit tyres: force from slip angle and slip ratio, bounded by one friction circle.

Wheels come first, [4, n]; velocities are those of the contact patch in the wheel's own axes,
x where it points, y to its left.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SLIP_STIFFNESS = 12.0  # [-] longitudinal force over load and slip ratio; plausible, not measured
# Below this rolling speed slip is taken over it, so that a parked tyre is a viscous damper
# instead of dividing by zero.
SLOWEST_ROLLING = 0.1  # [m/s]


class TyreForce(NamedTuple):
    """Forces on the car and how they fall as the patch moves faster; all [4, n]."""

    fx: NDArray
    """[N]"""
    fy: NDArray
    """[N]"""
    fx_sx: NDArray
    """d fx / d(slip velocity along x) [N s/m]"""
    fx_sy: NDArray
    fy_sx: NDArray
    fy_sy: NDArray


def tyre_force(
    slip_x: NDArray, slip_y: NDArray, rolling: NDArray, load: NDArray, grip, cornering
) -> TyreForce:
    """Combined-slip tyre force.

    s = (k_x kappa, C tan(-alpha)) / mu,  F = mu F_z s / sqrt(1 + |s|^2), with the slip ratio
    kappa = slip_x / |v| and the slip angle tan(-alpha) = slip_y / |v|: the magic formula
    D sin(C atan(B s)) with shape factor 1. So |F| < mu F_z always, and at small slip angles
    F_y = -C F_z alpha at every speed above `SLOWEST_ROLLING`.

    Args:
        slip_x: Circumference minus patch speed, omega r - v_x [m/s].
        slip_y: Minus the patch's sideways speed, -v_y [m/s].
        rolling: v_x of the patch [m/s].
        load: F_z [N], not negative.
        grip: mu [-].
        cornering: C [1/rad].
    """
    per_speed = 1.0 / np.maximum(np.abs(rolling), SLOWEST_ROLLING)
    bx = (SLIP_STIFFNESS * per_speed) / grip  # (4, n)
    by = cornering * per_speed / grip
    sx, sy = bx * slip_x, by * slip_y
    shrink = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
    secant = grip * load * shrink
    fx, fy = secant * sx, secant * sy
    # dF/ds = mu F_z / q (1 - s s^T / q^2),  q = sqrt(1 + |s|^2)
    nx, ny = sx * shrink, sy * shrink
    cross = -secant * nx * ny
    return TyreForce(
        fx,
        fy,
        fx_sx=secant * (1.0 - nx * nx) * bx,
        fx_sy=cross * by,
        fy_sx=cross * bx,
        fy_sy=secant * (1.0 - ny * ny) * by,
    )
