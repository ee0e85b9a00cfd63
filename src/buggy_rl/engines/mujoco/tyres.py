"""Explicit tyres: force from slip angle and slip ratio, bounded by one friction circle.

Wheels come first, [4, n]; velocities are those of the contact patch in the wheel's own axes,
x where it points, y to its left. Arrays are of NumPy or PyTorch.
"""

from typing import Any, NamedTuple

from array_api_compat import array_namespace

from buggy_rl.engines.mujoco.arrays import Array

SLIP_STIFFNESS = 12.0  # [-] longitudinal force over load and slip ratio; chosen, not measured
SLOWEST_ROLLING = 0.1  # [m/s] least speed slip is divided by: at rest a tyre is a damper; chosen
TINY = 1e-9  # [-] slip below which it has no direction


class TyreForce(NamedTuple):
    """Forces on the car and their derivatives by the slip velocity; all [4, n]."""

    fx: Array
    """[N]"""
    fy: Array
    """[N]"""
    fx_sx: Array
    """d fx / d(slip velocity along x) [N s/m]"""
    fx_sy: Array
    fy_sx: Array
    fy_sy: Array


class Tyre(NamedTuple):
    """Parameters of a tyre, each a number or [4, n]."""

    grip: Any
    """mu [-]."""
    cornering: Any
    """c, lateral force over load and slip angle at small slip [1/rad]."""
    shape: Any
    """C [-], 1 to 2."""


def tyre_force(slip_x: Array, slip_y: Array, rolling: Array, load: Array, tyre: Tyre) -> TyreForce:
    """Combined-slip tyre force, Pacejka's magic formula.

    s = (k_x kappa, c tan(-alpha)) / mu,  F = mu F_z sin(C atan(|s| / C)) s / |s|, with the slip
    ratio kappa = slip_x / |v| and the slip angle tan(-alpha) = slip_y / |v|. So |F| <= mu F_z
    always, and at small slip angles F_y = -c F_z alpha at every speed above `SLOWEST_ROLLING`.
    With C = 1 the force tends to mu F_z, F = mu F_z s / sqrt(1 + |s|^2); with C > 1 it peaks at
    |s| = C tan(pi / 2C) and falls beyond.

    Source: Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 4.3, without curvature factor.

    Args:
        slip_x: Circumference minus patch speed, omega r - v_x [m/s].
        slip_y: Minus the patch's sideways speed, -v_y [m/s].
        rolling: v_x of the patch [m/s].
        load: F_z [N], not negative.
        tyre: Its parameters.
    """
    xp = array_namespace(slip_x)
    grip, cornering, shape = tyre
    per_speed = 1.0 / xp.maximum(xp.abs(rolling), SLOWEST_ROLLING)
    bx = (SLIP_STIFFNESS * per_speed) / grip  # (4, n)
    by = cornering * per_speed / grip
    sx, sy = bx * slip_x, by * slip_y
    slip = xp.maximum(xp.sqrt(sx * sx + sy * sy), TINY)
    angle = shape * xp.atan(slip / shape)
    most = grip * load
    secant = most * xp.sin(angle) / slip
    # Beyond the peak the slope is taken as 0: a negative one would make the Newton step diverge.
    slope = most * xp.maximum(xp.cos(angle), 0.0) / (1.0 + (slip / shape) ** 2)
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
