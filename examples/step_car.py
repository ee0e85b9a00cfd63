"""A simulator from two functions.

python scripts/diagnose.py simulator=examples/step_car.py:make "recordings=[FOLDER]" output=mine
"""

import numpy as np

from buggy_rl import Parameter, from_step

DT, WHEELBASE = 0.01, 0.174  # [s], [m]
PARAMETERS = [
    Parameter("drive", 6.0, 1.0, 20.0, "m/s^2", "Acceleration at full throttle, from rest."),
    Parameter("drag", 1.0, 0.1, 5.0, "1/s", "Deceleration over speed."),
    Parameter("lock", 0.36, 0.1, 0.7, "rad", "Angle of the front wheels at full steering."),
]


def reset(pose, velocity):
    """State of a car at a pose with a velocity: its servo stands straight ahead."""
    return {"pose": pose, "velocity": velocity, "servo": np.zeros(len(pose))}


def step(state, action, p):
    """State 10 ms later; n cars at once: pose [n, 3], action [n, 2], parameters [n]."""
    (x, y, yaw), vx = state["pose"].T, state["velocity"][:, 0]
    throttle, steering = action.T
    servo = state["servo"] + DT / 0.05 * (steering - state["servo"])
    vx = vx + DT * (p["drive"] * (throttle + 1) / 2 - p["drag"] * vx)
    yaw_rate = vx * np.tan(p["lock"] * servo) / WHEELBASE
    x, y = x + DT * vx * np.cos(yaw), y + DT * vx * np.sin(yaw)
    pose = np.stack([x, y, yaw + DT * yaw_rate], -1)
    return {"pose": pose, "velocity": np.stack([vx, 0 * vx, yaw_rate], -1), "servo": servo}


make = from_step(reset, step, parameters=PARAMETERS, batched=True)
