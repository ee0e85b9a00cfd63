"""A Gymnasium car as a simulator.

python scripts/diagnose.py simulator=examples/gym_car.py:make "recordings=[FOLDER]" output=runs/mine
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from buggy_rl import from_gymnasium

DT, WHEELBASE = 0.01, 0.174  # [s], [m]


class CarEnv(gymnasium.Env):
    """A kinematic car with a motor: state x, y, yaw, vx, vy, yaw rate, motor force over mass."""

    action_space = Box(np.array([0, -0.36], "f"), np.array([6, 0.36], "f"))  # m/s^2, rad
    observation_space = Box(-np.inf, np.inf, (7,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = np.zeros(7)
        return self.state.copy(), {}

    def step(self, action):
        x, y, yaw, vx, _, _, motor = self.state
        motor += DT / 0.05 * (action[0] - motor)
        vx += DT * (motor - 1.0 * vx)
        yaw_rate = vx * np.tan(action[1]) / WHEELBASE
        x, y, yaw = x + DT * vx * np.cos(yaw), y + DT * vx * np.sin(yaw), yaw + DT * yaw_rate
        self.state = np.array([x, y, yaw, vx, 0.0, yaw_rate, motor])
        return self.state.copy(), 0.0, False, False, {}


make = from_gymnasium(CarEnv, layout=("x", "y", "yaw", "vx", "vy", "yaw_rate", "motor"))
