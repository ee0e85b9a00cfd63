"""What a simulator's motor gives and loses, and where it begins to pull."""

from typing import Any

import numpy as np
import torch

from buggy_rl.effects.measuring.holding import Make, next_velocity, period

SPEEDS = (1.0, 3.0)  # [m/s] over which the drive is measured
DRIVES = (0.4, 0.55)  # at which the motor is measured: past any deadband; more would spin wheels
ONSET_SPEEDS = (0.5, 1.0)  # [m/s] at which the motor's onset is looked for
ONSETS = (0.0, 0.6)  # of the drive, between which it is looked for
LEAST_PULL = 0.2  # [m/s^2] of any motor at over half its drive


def measured_drive(make: Make) -> dict[str, Any]:
    """What a simulator loses coasting, and what its motor loses with the speed.

    Returns:
        `coasting` c0 [m/s^2], c1 [1/s] and `speed_loss` b0, b1 [1/s], as `TopSpeed` takes them.

    Raises:
        ValueError: The simulator's answer is not finite.
    """
    speeds, dt = torch.linspace(*SPEEDS, 6), period(make)
    held = torch.stack([speeds, torch.zeros(6), torch.zeros(6)], -1)

    def line(drive: float) -> tuple[float, float]:
        """Slope [1/s] and level [m/s^2] of the acceleration over the speed."""
        gained = (next_velocity(make, held, 2 * drive - 1)[:, 0] - speeds) / dt
        slope, level = np.polyfit(speeds.numpy(), gained.numpy(), 1)
        return float(slope), float(level)

    rolling, level = line(0.0)
    lost = [rolling - line(drive)[0] for drive in DRIVES]
    growth, rest = np.polyfit(DRIVES, lost, 1)
    return {
        "coasting": [round(max(-level, 0.0), 4), round(max(-rolling, 0.0), 4)],
        "speed_loss": [round(float(rest), 4), round(float(growth), 4)],
    }


def measured_onset(make: Make) -> float:
    """Drive in 0..1 at which a simulator's motor begins to pull, at rest.

    From the line that the acceleration follows once it pulls, back to what the car loses coasting;
    and from two speeds back to rest, because a turning motor asks for some drive by itself.

    Raises:
        ValueError: The simulator's answer is not finite, or it does not pull.
    """
    drives = torch.linspace(*ONSETS, 25)
    found = []
    for speed in ONSET_SPEEDS:
        held = torch.tensor([[speed, 0.0, 0.0]]).expand(len(drives), 3)
        gained = (next_velocity(make, held, 2 * drives - 1)[:, 0] - speed) / period(make)
        pull = (gained - gained[0]).double()
        top = float(pull.max())
        if top < LEAST_PULL:
            raise ValueError(f"at {speed:g} m/s no drive up to {ONSETS[1]:g} makes it faster")
        rising = (pull > 0.1 * top) & (pull < 0.6 * top)
        if int(rising.sum()) < 2:
            raise ValueError(f"at {speed:g} m/s its pull jumps: there is no line to an onset")
        slope, level = np.polyfit(drives[rising].numpy(), pull[rising].numpy(), 1)
        found.append(-level / slope)
    low, high = ONSET_SPEEDS
    at_rest = found[0] - low * (found[1] - found[0]) / (high - low)
    return round(float(np.clip(at_rest, *ONSETS)), 3)
