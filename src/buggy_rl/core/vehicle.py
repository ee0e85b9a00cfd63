"""The car's dimensions, its frames and its slip angles; everything here is planar and batched.

Axes are ISO 8855: x forward, y left, z up, yaw and steering angle positive to the left.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from buggy_rl.core.parameters import Parameter

GRAVITY = 9.80665  # [m/s^2] standard gravity, CGPM 1901
AT_REST = 1e-30  # beside the square of a length: lost in any that float32 tells from 0
CONTROL_PERIOD = 0.01  # [s] 100 Hz, the rate of the tracking camera


@dataclass(frozen=True)
class VehicleDimensions:
    """Dimensions and masses of the car.

    Length, mass and wheel arrangement are the original study's (chapter 4); the wheelbase, the
    position of the centre of gravity and the yaw inertia are those of its mass twin DART.
    """

    length: float = 0.273
    """Bumper to bumper [m]."""
    wheelbase: float = 0.174
    """Front to rear axle [m]."""
    cg_to_front_axle: float = 0.081
    """Centre of gravity behind the front axle [m]."""
    track_width: float = 0.155
    """Distance between the wheel centres of an axle [m]."""
    wheel_radius: float = 0.0325
    """Radius of the tread [m]."""
    wheel_width: float = 0.026
    """Width of the tread [m]."""
    mass: float = 1.625
    """Mass with battery and computer [kg]."""
    yaw_inertia: float = 0.0049
    """Inertia about the vertical axis through the centre of gravity [kg m^2]."""
    cg_height: float = 0.045
    """Centre of gravity above the floor [m]."""
    sensor_to_cg: float = 0.022
    """Tracking sensor ahead of the centre of gravity [m]; the body frame sits at the sensor."""

    @property
    def cg_to_rear_axle(self) -> float:
        """Centre of gravity to rear axle [m]."""
        return self.wheelbase - self.cg_to_front_axle


def wrap_angle(angle: Tensor) -> Tensor:
    """Wraps an angle [rad] of any shape to [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def side_by_side_columns(*parts: Tensor) -> Tensor:
    """Values [*] side by side, [*, k], each of them contiguous in memory: see `kernels.kernel`."""
    return torch.stack(torch.broadcast_tensors(*parts)).movedim(0, -1)


def planar_norm(x: Tensor, y: Tensor) -> Tensor:
    """sqrt(x^2 + y^2) [*], in a twentieth of the time of `vector_norm`.

    At rest its gradient is 0, where that of `hypot` is not a number.
    """
    return torch.sqrt(x.square() + y.square() + AT_REST)


def rotate(xy: Tensor, angle: Tensor) -> Tensor:
    """Turns vectors [*, 2] to the left by `angle` [*] rad: body to world frame for angle = yaw."""
    x, y = xy.unbind(-1)
    cos, sin = torch.cos(angle), torch.sin(angle)
    return side_by_side_columns(cos * x - sin * y, sin * x + cos * y)


def integrate_pose(
    pose: Tensor, velocity: Tensor, next_velocity: Tensor, dt: float | Tensor
) -> Tensor:
    """Moves a pose one step on, by the midpoint of the velocities at both ends.

    x' = x + dt R(yaw + dt r / 2) v,  yaw' = yaw + dt r,  with v, r the mean of both velocities.

    Args:
        pose: [*, 3] x, y [m], yaw [rad], world frame.
        velocity: [*, 3] vx, vy [m/s], yaw_rate [rad/s], body frame, at the start of the step.
        next_velocity: [*, 3] the same at its end.
        dt: Step [s].

    Returns:
        [*, 3] the pose at the end of the step; yaw is not wrapped.
    """
    x, y, yaw = pose.unbind(-1)
    vx, vy, yaw_rate = (0.5 * (velocity + next_velocity)).unbind(-1)
    heading = yaw + 0.5 * dt * yaw_rate
    cos, sin = torch.cos(heading), torch.sin(heading)
    dx, dy = (cos * vx - sin * vy) * dt, (sin * vx + cos * vy) * dt
    return side_by_side_columns(x + dx, y + dy, yaw + dt * yaw_rate)


def shift_velocity(velocity: Tensor, x: float | Tensor, y: float | Tensor = 0.0) -> Tensor:
    """Velocity [*, 3] of the point of the same rigid body at (x, y) [m] in the body frame.

    vx' = vx - r y,  vy' = vy + r x,  r' = r.
    """
    vx, vy, yaw_rate = velocity.unbind(-1)
    return side_by_side_columns(vx - yaw_rate * y, vy + yaw_rate * x, yaw_rate)


def shift_pose(pose: Tensor, x: float, y: float = 0.0) -> Tensor:
    """Pose [*, 3] of the point of the same rigid body at (x, y) [m] in the body frame."""
    yaw = pose[..., 2]
    arm = torch.tensor([x, y], dtype=pose.dtype, device=pose.device).expand_as(pose[..., :2])
    return torch.cat([pose[..., :2] + rotate(arm, yaw), pose[..., 2:]], -1)


def slip_angle(velocity: Tensor, steering_angle: float | Tensor, to_axle: float | Tensor) -> Tensor:
    """Slip angle of an axle: direction of its motion relative to that of its wheels.

    alpha = atan2(vy + l r, |vx|) - sign(vx) delta: in reverse a wheel turned to the left points to
    the right of where it rolls. Positive slip (moving to the left of where the wheel
    points) makes a force to the right: Fy = -C alpha.

    Args:
        velocity: [*, 3] vx, vy [m/s], yaw_rate [rad/s] at the centre of gravity, body frame.
        steering_angle: [*] road-wheel angle [rad], positive to the left.
        to_axle: Distance of the axle ahead of the centre of gravity [m]; negative at the rear.

    Returns:
        [*] rad.
    """
    vx, vy, yaw_rate = velocity.unbind(-1)
    moves = torch.atan((vy + to_axle * yaw_rate) / vx.abs().clamp_min(1e-3))
    return moves - steering_angle * torch.where(vx < 0, -1.0, 1.0).to(vx)


# Unit -> exponents of mass, length, speed; gravity is the same for all.
EXPONENTS: dict[str, tuple[float, float, float]] = {
    **{"-": (0, 0, 0), "rad": (0, 0, 0), "1/rad": (0, 0, 0), "s": (0, 0, 0)},
    **{"m": (0, 1, 0), "m/s": (0, 0, 1), "m/s^2": (0, 0, 0), "s/m": (0, 0, -1)},
    **{"kg": (1, 0, 0), "kg m^2": (1, 2, 0), "N": (1, 0, 0), "N/rad": (1, 0, 0)},
    **{"N s/m": (1, 0, -1), "N s/(m rad)": (1, 0, -1), "N s^2/m^2": (1, 0, -2)},
    **{"N/m": (1, -1, 0), "rad/s": (0, -1, 1), "1/s": (0, 0, -1), "Hz": (0, -0.5, 0)},
    **{"kg/m": (1, 0, -2), "1/m": (0, 0, -2), "rad/s^2": (0, -1, 0), "W/kg": (0, 0, 1)},
    **{"V": (0.5, 0, 0.5), "A": (0.5, 0, 0.5), "A s": (0.5, 0, 1.5), "ohm": (0, 0, 0)},
    **{"V s/rad": (0.5, 1, -0.5), "1/J": (-1, 0, -2), "1/min": (0, 0, 0), "s^2/m": (0, 0, 0)},
    **{"rad s^2/m": (0, 0, 0), "m/(s^2 rad)": (0, 0, 0)},
}


@dataclass(frozen=True)
class Similarity:
    """Ratios of a car to the buggy; those of the buggy itself are exactly 1."""

    mass: float = 1.0
    length: float = 1.0
    speed: float = 1.0

    @classmethod
    def between(
        cls,
        car: VehicleDimensions,
        reference: VehicleDimensions | None = None,
        speed: float | None = None,
    ) -> "Similarity":
        """Ratios of a car to another, the buggy by default.

        Args:
            car: The one.
            reference: The other.
            speed: Ratio of their speeds; sqrt of the ratio of their wheelbases by default.
        """
        reference = reference or VehicleDimensions()
        length = car.wheelbase / reference.wheelbase
        return cls(car.mass / reference.mass, length, math.sqrt(length) if speed is None else speed)

    @property
    def time(self) -> float:
        """Ratio of the times in which the cars drive lengths of their own, L / S."""
        return self.length / self.speed

    def of(self, unit: str) -> float:
        """Factor of a quantity of this unit.

        Raises:
            KeyError: The unit is not known.
        """
        if unit not in EXPONENTS:
            known = ", ".join(EXPONENTS)
            raise KeyError(f"no scaling law for the unit {unit!r}; available: {known}")
        mass, length, speed = EXPONENTS[unit]
        return self.mass**mass * self.length**length * self.speed**speed

    def scaled(self, parameter: Parameter) -> Parameter:
        """A parameter of the buggy with the value and the range of this car."""
        p, factor = parameter, self.of(parameter.unit)
        ends = (factor * p.lower, factor * p.upper)
        return Parameter(p.name, factor * p.value, *ends, p.unit, p.meaning)


def similar_dimensions(known: Mapping[str, float]) -> VehicleDimensions:
    """Dimensions of a car of which some are known; the others are those of a scaled buggy.

    Lengths go with the wheelbase, the yaw inertia with m L^2. Without a mass or a wheelbase it is
    the buggy's.

    Args:
        known: Fields of `VehicleDimensions`.

    Raises:
        ValueError: A name is not a dimension, or mass or wheelbase is not positive.
    """
    names, buggy = [f.name for f in fields(VehicleDimensions)], VehicleDimensions()
    unknown = sorted(set(known) - set(names))
    if unknown:
        raise ValueError(f"no dimension {', '.join(unknown)}; available: {', '.join(names)}")
    given = {"mass": buggy.mass, "wheelbase": buggy.wheelbase} | dict(known)
    for name in ("mass", "wheelbase"):
        if not given[name] > 0:
            raise ValueError(f"dimensions: {name} is {given[name]}: must be above 0")
    mass, length = given["mass"] / buggy.mass, given["wheelbase"] / buggy.wheelbase
    factor = dict.fromkeys(names, length) | {"yaw_inertia": mass * length**2}
    scaled = {name: factor[name] * getattr(buggy, name) for name in names}
    return VehicleDimensions(**(scaled | given))
