"""Identification of what is behind a command: brakes, or a speed controller."""

from typing import Any

import numpy as np
import torch

from buggy_rl.core.longitudinal import LongitudinalCommand, command_of, declared_by
from buggy_rl.effects.measuring.drive import (
    RISING,
    Make,
    next_velocities,
    next_velocity,
    period,
    resting,
)

BRAKED_SPEED = 1.5  # [m/s] speed of the experiment with the brakes; chosen
CONTROLLED_SPEEDS = (1.0, 1.75, 2.5)  # [m/s] of that with a speed controller; chosen
STEEPEST = 0.9  # [-] of the largest slope, from which on a controller is not at a limit; chosen
LEAST_BRAKE = 0.2  # [m/s^2] least deceleration of a full brake


def measured_command(make: Make) -> dict[str, Any]:
    """Properties of a command that is no one-way throttle, as the effects take them.

    Raises:
        ValueError: A velocity of the simulator is not finite, or a full brake does not brake.
    """
    command = declared_by(make(1))
    found: dict[str, Any] = {"rest": command.rest} if command.two_way else {}
    if command.kind == "throttle_brake_reverse":
        found |= _brakes(make)
    if command.kind == "speed":
        found |= _speed_control(make, command)
    return found


def _declared(make: Make, name: str) -> float | None:
    """A parameter of the simulator, where it declares it."""
    values = getattr(make(1), "values", {})
    return round(float(values[name].mean()), 6) if name in values else None


def _brakes(make: Make) -> dict[str, Any]:
    """Onset of the brake, deceleration at full brake and share of it in front."""
    drives = torch.linspace(0.0, 1.0, 41)
    held = torch.tensor([[BRAKED_SPEED, 0.0, 0.0]]).expand(len(drives), 3)
    lost = (BRAKED_SPEED - next_velocity(make, held, -drives)[:, 0]) / period(make)
    lost = (lost - lost.min()).double()
    most = float(lost.max())
    if most < LEAST_BRAKE:
        raise ValueError(f"at {BRAKED_SPEED:g} m/s a full brake takes {most:.2g} m/s^2: no brake")
    # Its lower part: above it the tyres may slide. A drag brake is on before the onset.
    past = torch.arange(len(drives)) > int(lost.argmin())
    rising = past & (lost > RISING[0] * most) & (lost < RISING[1] * most)
    slope, level = np.polyfit(drives[rising].numpy(), lost[rising].numpy(), 1)
    onset = float(np.clip(-level / slope, 0.0, 0.6))
    share = _declared(make, "brake_front_share")
    return {
        "reverse_onset": round(onset, 3),
        "braking": round(float(slope * (1 - onset)), 3),
        "brake_front_share": 0.0 if share is None else share,
    }


def _speed_control(make: Make, command: LongitudinalCommand) -> dict[str, Any]:
    """Gain and full speed of a controller, and the deceleration of the car without its force.

    Where it is at no limit, a = k (v_full u - v) - c0 - c1 v: a plane. Its three numbers leave c1
    open, which is 0 unless the simulator declares `full_speed`.
    """
    drives, rows = torch.linspace(0.0, 1.0, 81), []
    for speed in CONTROLLED_SPEEDS:
        held = torch.tensor([[speed, 0.0, 0.0]]).expand(len(drives), 3)
        after = next_velocity(make, held, command_of(drives, command.rest))[:, 0]
        gained = ((after - speed) / period(make)).double().numpy()
        slope = np.gradient(gained, drives.double().numpy())
        free = slope > STEEPEST * slope.max()
        rows += [(u, speed, a) for u, a in zip(drives[free].tolist(), gained[free], strict=True)]
    u, v, a = np.array(rows).T
    per_command, per_speed, level = np.linalg.lstsq(
        np.stack([u, v, np.ones_like(u)], -1), a, rcond=None
    )[0]
    full_speed = _declared(make, "full_speed") or float(per_command / -per_speed)
    gain = float(per_command / full_speed)
    rolling = max(-float(per_speed) - gain, 0.0)
    return {
        "speed_gain": round(gain, 4),
        "full_speed": round(full_speed, 4),
        "coasting": [
            round(max(-float(level), 0.0), 4),
            round(rolling, 4),
        ],
    }


SERVO_SPEED = 2.0  # [m/s] speed of the experiment; chosen
SERVO_STEP = 0.15  # [-] step of the steering, so small that no rate limit acts; chosen
RESPONSE = 0.6  # [s] length of the response: over four time constants of DART's servo
LEAST_TURN = 0.5  # [rad/s^2] least yaw acceleration of a car that steers
MISSING = (0.05, 0.85)  # [-] range of the missing share of the response that is fitted


def measured_steering_lag(make: Make) -> float:
    """Time constant [s] of the road wheels' response to a step of the steering; 0: none seen.

    The car is held in straight motion; the yaw rate after one further step grows with the
    road-wheel angle. The logarithm of the missing share falls by dt / T each step, whatever the
    dead time.

    Raises:
        ValueError: A velocity of the simulator is not finite, it does not turn, or the response is
            not over after `RESPONSE`.
    """
    dt = period(make)
    held = torch.tensor([[SERVO_SPEED, 0.0, 0.0]])
    rows = round(RESPONSE / dt)
    after = next_velocities(make, held, resting(make), SERVO_STEP, rows)  # (R, 1, 3)
    turn = after[:, 0, 2].double()
    turn = turn - turn[0]
    last = float(turn[-1])
    if abs(last) / dt < LEAST_TURN:
        raise ValueError(f"at {SERVO_SPEED:g} m/s it does not turn for steering {SERVO_STEP:g}")
    missing = 1 - turn / last
    fitted = (missing < MISSING[1]) & (missing > MISSING[0])
    others = fitted.logical_not().nonzero().flatten()
    first = int(fitted.nonzero()[0]) if bool(fitted.any()) else 0
    end = int(others[others > first][0]) if bool(fitted.any()) else 0
    if end - first < 2:  # over within two steps
        return 0.0
    row = np.arange(first, end)
    slope = np.polyfit(row * dt, missing[first:end].log().numpy(), 1)[0]
    if -slope * RESPONSE < 1:
        raise ValueError(f"its wheels still turn {RESPONSE:g} s after a step of the steering")
    return round(-1.0 / float(slope), 4)
