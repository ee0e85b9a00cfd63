"""The floor's push on the wheels as a force, so that no contact has to be solved.

A wheel on the floor passes on what its strut carries. Beside that, a critically damped spring keeps
its lowest point at the floor:

    N = max(0, S - m (2 v / T + z / T^2)),

with S what strut and wheel weigh on it, z and v the height and speed of its lowest point, m the
inertia along the strut. Under a chassis at rest dv/dt = -2 v / T - z / T^2. The floor never pulls.
"""

from typing import Any

from array_api_compat import array_namespace

from buggy_rl.simulators.mujoco.arrays import Array
from buggy_rl.simulators.mujoco.car import CompiledCar

# Over 512 random drives of 1 s at 2.5 ms the worst path is 0.33 % of its length from that with
# MuJoCo's contacts; with 20 ms, the time constant of those, 0.96 %, with 5 ms 1.7 %.
SETTLING = 0.01  # [s] T
STEPS = 4  # timesteps that T has at least, for stability: the spring is explicit


def settling_rate(timestep: Any) -> Any:
    """1 / T [1/s] at a timestep of the physics [s]."""
    longest = STEPS * timestep
    if isinstance(longest, float):
        return 1.0 / max(SETTLING, longest)
    return 1.0 / longest.clip(SETTLING)  # of a kernel, which takes any timestep


class Floor:
    """Push of a flat floor on the wheels of n environments, without state.

    Args:
        car: Compiled model.
    """

    def __init__(self, car: CompiledCar) -> None:
        self.car, weights = car, car.weights
        self._rate = settling_rate(car.timestep)
        self._inertia = weights.wheel_mass + weights.strut_armature
        self._hub_z = car.dimensions.wheel_radius - car.dimensions.cg_height

    def push(self, qpos: Array, qvel: Array, carried: Array) -> Array:
        """Force [4, n] upwards at each wheel [N].

        Args:
            qpos: [n, nq].
            qvel: [n, nv].
            carried: [4, n] force of each strut on its wheel, with the wheel's weight [N].
        """
        height, speed = self.heights(qpos, qvel)
        back = self._rate * (2.0 * speed + self._rate * height)
        return array_namespace(qpos).maximum(carried - self._inertia * back, 0.0)

    def heights(self, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """Height [m] and upward speed [m/s] of the lowest point of each wheel, both [4, n].

        z = z_0 + u . r,  v = v_0 + (u x omega) . r + u_z ds/dt, with u the vertical, omega and
        r = (hub_x, hub_y, hub_z + s) in body axes.
        """
        w, x, y, z = qpos[:, 3:7].T
        up_x, up_y, up_z = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        p, q, r = qvel[:, 3:6].T
        slide, hub_x, hub_y = self.car.slide, self.car.hub_x, self.car.hub_y
        hub_z = self._hub_z + qpos[:, slide + 1].T  # (4, n)
        height = qpos[:, 2] - self.car.dimensions.wheel_radius
        height = height + up_x * hub_x + up_y * hub_y + up_z * hub_z
        speed = qvel[:, 2] + (up_y * r - up_z * q) * hub_x + (up_z * p - up_x * r) * hub_y
        return height, speed + (up_x * q - up_y * p) * hub_z + up_z * qvel[:, slide].T
