"""How late a simulator's front wheels follow the steering."""

import numpy as np
import torch

from buggy_rl.effects.measuring.holding import Make, next_velocities, period

SERVO_SPEED = 2.0  # [m/s] at which the servo is measured,
SERVO_STEP = 0.15  # by a step of the steering so small that no servo is at its fastest,
SERVO_ROWS = 60  # that it has this many rows to follow
LEAST_TURN = 0.5  # [rad/s^2] of any car that steers


def measured_steering_lag(make: Make) -> float:
    """Time constant [s] with which a simulator's wheels follow a step of the steering.

    The car is held in straight motion; what its next step would turn grows as the wheels do. Of
    what is still missing, the logarithm falls by dt / T each step: no dead time changes that.

    Raises:
        ValueError: The simulator's answer is not finite, or it does not turn.
    """
    dt = period(make)
    held = torch.tensor([[SERVO_SPEED, 0.0, 0.0]])
    turn = next_velocities(make, held, -1.0, SERVO_STEP, SERVO_ROWS)[:, 0, 2].double()  # (R,)
    turn = turn - turn[0]
    last = float(turn[-1])
    if abs(last) / dt < LEAST_TURN:
        raise ValueError(f"at {SERVO_SPEED:g} m/s it does not turn for steering {SERVO_STEP:g}")
    missing = 1 - turn / last
    falling = (missing < 0.85) & (missing > 0.05)
    gone = falling.logical_not().nonzero().flatten()
    first = int(falling.nonzero()[0]) if bool(falling.any()) else 0
    end = int(gone[gone > first][0]) if bool(falling.any()) else 0
    if end - first < 2:  # over before it can be seen
        return 0.0
    row = np.arange(first, end)
    fall = np.polyfit(row * dt, missing[first:end].log().numpy(), 1)[0]
    if -fall * SERVO_ROWS * dt < 1:
        raise ValueError(f"its wheels have not come to rest {SERVO_ROWS * dt:g} s after a step")
    return round(-1.0 / float(fall), 4)
