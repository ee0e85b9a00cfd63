"""Identification of what is behind a command: brakes, or a speed controller."""

from typing import Any

import numpy as np
import torch

from buggy_rl.effects.measuring.drive import RISING
from buggy_rl.effects.measuring.holding import Make, next_velocity, period
from buggy_rl.longitudinal import LongitudinalCommand, command_of, declared_by

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
