"""Identification of the first-order lag of a simulator's steering servo."""

import numpy as np
import torch

from buggy_rl.effects.measuring.holding import Make, next_velocities, period, resting

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
