"""What a driver makes of the waypoints ahead: where they will be, how they bend, how fast to go."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand, command_of
from buggy_rl.core.vehicle import rotate
from buggy_rl.policies.controllers.tuning import Number, within

STANDS = 0.3  # [m/s] speed of a buggy below which it is not braked: a command would reverse it
FULL_SPEED = 5.0  # [m/s] setpoint of a full speed command where none is known, as engines have it
STRAIGHT = 1e-3  # [1/m] curvature below which a path limits no speed


@dataclass(frozen=True)
class SpeedConfig:
    """How fast to drive, and the throttle for it."""

    top_speed: Number = field(default=3.2, metadata=within(1.5, 4.0))
    """Speed on a straight [m/s]."""
    lateral_acceleration: Number = field(default=5.0, metadata=within(2.0, 9.0))
    """Lateral acceleration in a bend [m/s^2]."""
    braking: Number = field(default=1.5, metadata=within(0.4, 4.0))
    """Deceleration counted on without drive [m/s^2]."""
    unseen_speed: Number = field(default=2.0, metadata=within(1.0, 4.0))
    """Speed to be slowed down to by the last waypoint in sight: what comes after may bend [m/s]."""
    drive_at_rest: Number = field(default=0.2, metadata=within(0.1, 0.3))
    """Drive in 0..1 that just moves the car."""
    drive_per_speed: Number = field(default=0.07, metadata=within(0.02, 0.15))
    """Further drive for each m/s to be held [s/m]."""
    gain: Number = field(default=0.6, metadata=within(0.1, 2.0))
    """Further drive for each m/s that is missing [s/m]."""


def ahead(waypoints: Tensor, velocity: Tensor, delay: Number) -> Tensor:
    """Waypoints [*, W, 2] as a car will see them that goes on as it does for `delay` [s].

    x = vx T - vy r T^2 / 2,  y = vy T + vx r T^2 / 2,  yaw = r T.
    """
    vx, vy, yaw_rate = velocity.unbind(-1)
    bend = 0.5 * delay * delay * yaw_rate
    shift = torch.stack([vx * delay - vy * bend, vy * delay + vx * bend], -1)  # (*, 2)
    turn = (yaw_rate * delay).unsqueeze(-1).expand(waypoints.shape[:-1])
    return rotate(waypoints - shift.unsqueeze(-2), -turn)


def with_past(waypoints: Tensor) -> Tensor:
    """Waypoints [*, W + 2, 2] with two more before the first, on the same bend.

    The next waypoint is up to a spacing away, and the path between it and the car out of sight.
    """
    first, second, third = (waypoints[..., i, :] for i in range(3))
    step = second - first
    turn = heading(third - second) - heading(step)
    before = first - rotate(step, -turn)
    earlier = before - rotate(step, -2 * turn)
    return torch.cat([torch.stack([earlier, before], -2), waypoints], -2)


def heading(step: Tensor) -> Tensor:
    """Direction [*] of vectors [*, 2] [rad]."""
    x, y = step.unbind(-1)
    return torch.atan2(y, x)


def curvature(waypoints: Tensor) -> Tensor:
    """Curvature of circles through three waypoints in a row [*, W - 2] [1/m], positive to the left.

    kappa = 2 (a x b) / (|a| |b| |a + b|)
    """
    step = waypoints.diff(dim=-2)
    a, b = step[..., :-1, :], step[..., 1:, :]
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return 2 * cross / (_length(a) * _length(b) * _length(a + b)).clamp_min(1e-9)


def _length(step: Tensor) -> Tensor:
    return torch.linalg.vector_norm(step, dim=-1)


def allowed_speed(waypoints: Tensor, config: SpeedConfig) -> Tensor:
    """Fastest speed [*] that the bends in sight of waypoints [*, W, 2] allow now [m/s].

    v^2 = min_i (a_lat / |kappa_i| + 2 a_brake s_i), with s_i the way to waypoint i.
    """
    gaps = torch.cat([waypoints[..., :1, :], waypoints.diff(dim=-2)], -2)
    way = _length(gaps).cumsum(-1)  # (*, W)
    bend = curvature(with_past(waypoints)).abs().clamp_min(STRAIGHT)  # (*, W), here, w_0 .. w_W-2
    to_bend = torch.cat([torch.zeros_like(way[..., :1]), way[..., :-1]], -1)
    lateral, braking = _column(config.lateral_acceleration), _column(config.braking)
    squared = (lateral / bend + 2 * braking * to_bend).amin(-1)
    unseen = config.unseen_speed * config.unseen_speed + 2 * config.braking * way[..., -1]
    top = torch.as_tensor(config.top_speed, dtype=squared.dtype)
    return torch.minimum(torch.minimum(squared, unseen).sqrt(), top)


def _column(number: Number) -> Number:
    return number.unsqueeze(-1) if isinstance(number, Tensor) else number


def throttle(
    speed: Tensor,
    wanted: Tensor,
    config: SpeedConfig,
    command: LongitudinalCommand = ONE_WAY,
) -> Tensor:
    """First command [*] in [-1, 1] that brings `speed` [*] to `wanted` [*] [m/s].

    u = d_0 + d_1 v_wanted + k (v_wanted - v), below 0 a brake where the car has one; a car that
    stands is not reversed. A speed command is the speed that is wanted.
    """
    if command.kind == "speed":
        setpoint = wanted / (command.full_speed or FULL_SPEED)
        return command_of(setpoint.clamp(0.0, 1.0), command.rest)
    steady = config.drive_at_rest + config.drive_per_speed * wanted
    drive = steady + config.gain * (wanted - speed)
    if not command.two_way:
        return 2.0 * drive.clamp(0.0, 1.0) - 1.0
    forward = drive.clamp(0.0, 1.0)
    return torch.where(speed > STANDS, drive.clamp(-1.0, 1.0), forward)
