"""Identification of a simulator's coasting deceleration, back-EMF and motor deadband."""

from typing import Any

import numpy as np
import torch

from buggy_rl.effects.measuring.holding import Make, next_velocity, period, resting
from buggy_rl.longitudinal import command_of

SPEEDS = (1.0, 3.0)  # [m/s] range of the fit of acceleration over speed
DRIVES = (0.4, 0.55)  # [-] drives of that fit: above deadbands up to 0.3, below wheel spin
ONSET_SPEEDS = (0.5, 1.0)  # [m/s] speeds from which the onset is extrapolated to rest
ONSETS = (0.0, 0.6)  # [-] range of drives searched for the onset
LEAST_PULL = 0.2  # [m/s^2] least acceleration of a motor at over half its drive
RISING = (0.1, 0.6)  # [-] shares of the largest acceleration between which a line is fitted


def measured_drive(make: Make) -> dict[str, Any]:
    """Deceleration while coasting, and decrease of the motor's acceleration with the speed.

    Returns:
        `coasting` c0 [m/s^2], c1 [1/s] and `speed_loss` b0, b1 [1/s], as `TopSpeed` takes them.

    Raises:
        ValueError: A velocity of the simulator is not finite.
    """
    speeds, drives = torch.linspace(*SPEEDS, 6), torch.tensor([0.0, *DRIVES])
    held = torch.zeros(len(drives), len(speeds), 3)
    held[..., 0] = speeds
    throttle = command_of(drives, resting(make)).repeat_interleave(len(speeds))
    after = next_velocity(make, held.flatten(0, 1), throttle)[:, 0].view(len(drives), -1)
    acceleration = (after - speeds) / period(make)
    # Slope [1/s] and level [m/s^2] over the speed, of each drive.
    slopes, levels = np.polyfit(speeds.numpy(), acceleration.T.numpy(), 1)
    (rolling, *driven), level = slopes.tolist(), float(levels[0])
    lost = [rolling - slope for slope in driven]
    growth, standing = np.polyfit(DRIVES, lost, 1)
    return {
        "coasting": [round(max(-level, 0.0), 4), round(max(-rolling, 0.0), 4)],
        "speed_loss": [round(float(standing), 4), round(float(growth), 4)],
    }


def measured_onset(make: Make) -> float:
    """Drive in 0..1 at which a simulator's motor begins to give force, at rest.

    The acceleration over the drive is a line above the onset; it is extrapolated down to the
    coasting acceleration, and from two speeds to rest, because back-EMF takes some drive too.

    Raises:
        ValueError: A velocity of the simulator is not finite, or the motor gives no force.
    """
    drives, rest = torch.linspace(*ONSETS, 25), resting(make)
    held = torch.zeros(len(ONSET_SPEEDS), len(drives), 3)
    held[..., 0] = torch.tensor(ONSET_SPEEDS).unsqueeze(-1)
    throttle = command_of(drives, rest).repeat(len(ONSET_SPEEDS))
    after = next_velocity(make, held.flatten(0, 1), throttle).view_as(held)
    found = []
    for speed, acceleration in zip(
        ONSET_SPEEDS, (after - held)[..., 0] / period(make), strict=True
    ):
        pull = (acceleration - acceleration[0]).double()
        top = float(pull.max())
        if top < LEAST_PULL:
            raise ValueError(f"at {speed:g} m/s no drive up to {ONSETS[1]:g} makes it faster")
        rising = (pull > RISING[0] * top) & (pull < RISING[1] * top)
        if int(rising.sum()) < 2:
            raise ValueError(
                f"at {speed:g} m/s its acceleration jumps with the drive: no line to an onset"
            )
        slope, level = np.polyfit(drives[rising].numpy(), pull[rising].numpy(), 1)
        found.append(-level / slope)
    low, high = ONSET_SPEEDS
    at_rest = found[0] - low * (found[1] - found[0]) / (high - low)
    return round(float(np.clip(at_rest, *ONSETS)), 3)
