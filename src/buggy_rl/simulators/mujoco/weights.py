"""Masses, inertias and springs of the car: the buggy's, scaled to the car's mass and wheelbase.

The whole car has the mass, yaw inertia and centre of gravity asked for; the chassis has that of the
whole less the wheels. Arrays follow numpy's broadcasting, `*` over environments.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from buggy_rl.core.vehicle import GRAVITY, Similarity, VehicleDimensions
from buggy_rl.simulators.mujoco.arrays import Array, stacked

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")

# Chosen for 65 mm wheels and a soft off-road suspension; none is measured on a car.
WHEEL_MASS = 0.03  # [kg]
WHEEL_SPIN_INERTIA = 2.2e-5  # [kg m^2] 0.7 m r^2, between a disc and a ring
WHEEL_TILT_INERTIA = 1.2e-5  # [kg m^2]
DRIVELINE_INERTIA = 3.0e-5  # [kg m^2] motor and gears, reduced to one rear wheel
SPRING_RATE = 500.0  # [N/m] a wheel: the body bounces at 5.6 Hz
SPRING_DAMPING = 14.0  # [N s/m] a wheel: half of critical
SUSPENSION_TRAVEL = 0.015  # [m] to each side; chosen
# MuJoCo's contact solver does not include the implicit damper: without inertia along the strut the
# light wheels hop at a step of 5 ms, and at 2.5 ms with 0.1 kg still after an abrupt end of a slide
# (measured: the hop has up to 1.2 % of the slide's energy; with 0.2 kg 0.03 %).
# Explicit tyres, which need no contact solver, keep it: without it 512 random drives of 1 s end
# elsewhere by 0.24 % of their length on average and 2.6 % at worst.
STRUT_ARMATURE = 0.2  # [kg] inertia along the strut
STEERING_ARMATURE = 1.0  # [kg m^2] a servo that no tyre moment turns
PITCH_SHARE, ROLL_SHARE = 0.8, 0.3  # [-] inertias over the yaw inertia: a long plate; chosen


@dataclass(frozen=True)
class Weights:
    """Wheels and suspension of one car."""

    wheel_mass: float
    """[kg]"""
    spin_inertia: float
    """Spin inertia of a wheel [kg m^2]."""
    tilt_inertia: float
    """Tilt inertia of a wheel [kg m^2]."""
    driveline_inertia: float
    """Motor and gears, reduced to one rear wheel [kg m^2]."""
    spring_rate: float
    """Spring rate of a wheel [N/m]."""
    spring_damping: float
    """Damping of a wheel [N s/m]."""
    suspension_travel: float
    """Travel to each side [m]."""
    strut_armature: float
    """[kg]"""
    steering_armature: float
    """[kg m^2]"""

    @classmethod
    def of(cls, dimensions: VehicleDimensions) -> "Weights":
        """The buggy's, similar at the time scale sqrt(L / g): those of the buggy are exact."""
        scale = Similarity.between(dimensions)
        mass, length, inertia = (scale.of(unit) for unit in ("kg", "m", "kg m^2"))
        return cls(
            wheel_mass=mass * WHEEL_MASS,
            spin_inertia=inertia * WHEEL_SPIN_INERTIA,
            tilt_inertia=inertia * WHEEL_TILT_INERTIA,
            driveline_inertia=inertia * DRIVELINE_INERTIA,
            spring_rate=mass / length * SPRING_RATE,
            spring_damping=mass / math.sqrt(length) * SPRING_DAMPING,
            suspension_travel=length * SUSPENSION_TRAVEL,
            strut_armature=mass * STRUT_ARMATURE,
            steering_armature=inertia * STEERING_ARMATURE,
        )


def hub(dimensions: VehicleDimensions, wheel: str) -> list[float]:
    """Wheel centre in the body frame, suspension at rest."""
    x = dimensions.cg_to_front_axle - dimensions.sensor_to_cg
    if wheel.startswith("rear"):
        x -= dimensions.wheelbase
    y = dimensions.track_width / 2 * (1 if wheel.endswith("left") else -1)
    return [x, y, dimensions.wheel_radius - dimensions.cg_height]


def chassis_inertia(
    dimensions: VehicleDimensions, mass, yaw_inertia, cg_to_front_axle
) -> dict[str, np.ndarray]:
    """Mass and inertia of the chassis such that the whole car has the given ones.

    m_c = m - 4 m_w,  I_c = I - sum_i (I_w + m_w |r_i - r_cg|^2) - m_c |r_c - r_cg|^2.

    Args:
        dimensions: Places of the wheels and height of the centre of gravity.
        mass: [*] whole car [kg].
        yaw_inertia: [*] whole car, about its centre of gravity [kg m^2].
        cg_to_front_axle: [*] m.

    Returns:
        `mass` [*], `ipos` [*, 3] in the body frame, `inertia` [*, 3] about roll, pitch, yaw.

    Raises:
        ValueError: The wheels alone have more.
    """
    wheel = Weights.of(dimensions)
    mass, yaw_inertia, cg = np.broadcast_arrays(mass, yaw_inertia, cg_to_front_axle)
    front = dimensions.cg_to_front_axle - dimensions.sensor_to_cg  # axle ahead of the sensor
    cg_x = front - cg
    hubs = np.array([hub(dimensions, name) for name in WHEELS])
    chassis_mass = mass - len(WHEELS) * wheel.wheel_mass
    ipos = np.stack(
        [
            (mass * cg_x - wheel.wheel_mass * hubs[:, 0].sum()) / chassis_mass,
            np.zeros_like(cg_x),
            -wheel.wheel_mass * hubs[:, 2].sum() / chassis_mass,
        ],
        -1,
    )
    arms = (hubs[:, 0] - cg_x[..., None]) ** 2 + hubs[:, 1] ** 2  # (*, 4)
    wheels = len(WHEELS) * wheel.tilt_inertia + wheel.wheel_mass * arms.sum(-1)
    yaw = yaw_inertia - wheels - chassis_mass * (ipos[..., 0] - cg_x) ** 2
    if (chassis_mass <= 0).any() or (yaw <= 0).any():
        raise ValueError(
            f"a car of {mass.min():.3g} kg and yaw inertia {yaw_inertia.min():.3g} kg m^2 leaves "
            f"none for the chassis: its wheels have {len(WHEELS) * wheel.wheel_mass:.3g} kg and "
            f"have {wheels.max():.3g} kg m^2"
        )
    shares = np.array([ROLL_SHARE, PITCH_SHARE, 1.0])
    return {"mass": chassis_mass, "ipos": ipos, "inertia": yaw[..., None] * shares}


def spring_reference(wheel: Weights, wheelbase: Any, values: Mapping[str, Array]) -> Array:
    """Unloaded place [4, n] of the wheels [m] at which the car stands level.

    k (0 - s_0) = F_z - m_w g, with F_z the wheel's share of the car's weight.
    """
    to_front = values["cg_to_front_axle"] / wheelbase
    weight = values["mass"] * GRAVITY
    front, rear = weight * (1 - to_front) / 2, weight * to_front / 2  # a wheel
    load = stacked([front, front, rear, rear])
    return -(load - wheel.wheel_mass * GRAVITY) / wheel.spring_rate
