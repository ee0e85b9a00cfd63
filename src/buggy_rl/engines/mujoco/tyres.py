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
TINY = 1e-9  # [-] slip below which there is no direction


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
    slip_x: NDArray, slip_y: NDArray, rolling: NDArray, load: NDArray, grip, cornering, shape
) -> TyreForce:
    """Combined-slip tyre force, Pacejka's magic formula.

    s = (k_x kappa, c tan(-alpha)) / mu,  F = mu F_z sin(C atan(|s| / C)) s / |s|, with the slip
    ratio kappa = slip_x / |v| and the slip angle tan(-alpha) = slip_y / |v|. So |F| <= mu F_z
    always, and at small slip angles F_y = -c F_z alpha at every speed above `SLOWEST_ROLLING`.
    With C = 1 the force comes to mu F_z in the end, F = mu F_z s / sqrt(1 + |s|^2); with more it
    does so at |s| = C tan(pi / 2C), and falls in a slide.

    Args:
        slip_x: Circumference minus patch speed, omega r - v_x [m/s].
        slip_y: Minus the patch's sideways speed, -v_y [m/s].
        rolling: v_x of the patch [m/s].
        load: F_z [N], not negative.
        grip: mu [-].
        cornering: c [1/rad].
        shape: C [-], 1 to 2.
    """
    per_speed = 1.0 / np.maximum(np.abs(rolling), SLOWEST_ROLLING)
    bx = (SLIP_STIFFNESS * per_speed) / grip  # (4, n)
    by = cornering * per_speed / grip
    sx, sy = bx * slip_x, by * slip_y
    slip = np.maximum(np.sqrt(sx * sx + sy * sy), TINY)
    angle = shape * np.arctan(slip / shape)
    most = grip * load
    secant = most * np.sin(angle) / slip
    # Where a slide has less force the faster it is, the end of a substep is not sought by slope.
    slope = most * np.maximum(np.cos(angle), 0.0) / (1.0 + (slip / shape) ** 2)
    # dF/ds = secant (1 - n n^T) + slope n n^T,  n = s / |s|
    nx, ny, over = sx / slip, sy / slip, secant - slope
    cross = -over * nx * ny
    return TyreForce(
        secant * sx,
        secant * sy,
        fx_sx=(secant - over * nx * nx) * bx,
        fx_sy=cross * by,
        fy_sx=cross * bx,
        fy_sy=(secant - over * ny * ny) * by,
    )
