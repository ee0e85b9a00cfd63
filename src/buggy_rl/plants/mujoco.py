"""The MuJoCo car as a plant, with faults in its model, forces and actuators.

In the model: gravity is tilted (`floor_slope`), the chassis is heavier (`payload`, with its own
radius of gyration). In the tyre law: friction by axle and by the place of each wheel
(`tire_grip`, `grip_balance`, `grip_patch`), the stiffness kept. In the applied forces: air, wind,
drags, couples on the rear hubs (`one_sided_drag`, `torque_steer`, `stiff_differential`), a moment
(`yaw_damping`). In the linkage: angles by the forces of a steady turn and of the drive
(`understeer`, `dive_steer`). In the actuators: dead times are longer, and behind the car's own lags
come the stages of `mechanics`. In the motor: less back-EMF (`top_speed`), a gear (`gear_ratio`), a
limit at the shaft (`motor_power_limit`).

Differences from the textbook's parameter: the wheels' inertia makes a slope of 0.3 m/s^2 accelerate
the free car by 0.3 m / (m + sum I / r^2), 8 % less (drags are of the whole car and exact); with a
payload the car's rolling resistance stays, in newton; `battery_sag` counts charge, not time, and is
exact at the mean current of a room drive; `steering_gain` above 1 exceeds the lock.
"""

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.engines.mujoco import MujocoEngine
from buggy_rl.engines.mujoco.car import Car
from buggy_rl.engines.mujoco.forces import read_motion
from buggy_rl.plants.faults import EFFECTS, Faults
from buggy_rl.plants.mechanics import RESTING, Mechanics
from buggy_rl.plants.mujoco_forces import FaultyForces
from buggy_rl.vehicle import GRAVITY

ABILITIES = EFFECTS
MEMORY = "plant_memory"  # [len(RESTING)] of `mechanics`
PAYLOAD_RADIUS = 0.05  # [m] radius of gyration of the payload: a block of 0.12 m; chosen
TYPICAL_FORCE = 2.5  # [N] of the motor, mean of three room drives of 60 s


def make_mujoco(
    cars: int, faults: Mapping[str, Mapping[str, float]], parameters: Mapping[str, float] | None
) -> "MujocoPlant":
    """MuJoCo cars with faults."""
    return MujocoPlant(cars, parameters=parameters, faults=faults)


class MujocoPlant(MujocoEngine):
    """A MuJoCo engine with faults; without them equal to the engine.

    Args:
        *args: As for `MujocoEngine`.
        faults: `{effect: {parameter: value}}`.
        **options: As for `MujocoEngine`, explicit tyres only.

    Raises:
        KeyError: There is no such effect or parameter.
        ValueError: A value is outside its range.
    """

    def __init__(
        self, *args: Any, faults: Mapping[str, Mapping[str, float]] | None = None, **options: Any
    ) -> None:
        self._faults = Faults(faults or {}, ABILITIES, "mujoco")
        super().__init__(*args, **options)

    def _prepare(self) -> None:
        faults, nominal = self._faults, self.values
        if "floor_slope" in faults:
            self.car = tilted(self.car, faults)
        self.values = with_faults(nominal, faults)
        super()._prepare()
        self._mechanics = Mechanics(faults, self.car.timestep, TYPICAL_FORCE)
        self._forces = FaultyForces(self.car, self._forces.values, faults)
        self.values = nominal  # declared are the values without faults

    _parameters_changed = _prepare

    def _latent_specs(self) -> dict[str, TensorSpec]:
        memory = self._number_specs({MEMORY: (len(RESTING),)}, torch.float64)
        return super()._latent_specs() | memory

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        memory = self._tensor(Mechanics.rest(len(self._cars.qpos)))
        return super()._rest_latent(pose, velocity) | {MEMORY: memory}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        trims = (self._faults["throttle_offset.offset"], self._faults["steering_offset.offset"])
        if any(trims):  # clamped to the ends of the channel
            action = (action + action.new_tensor(trims)).clamp(-1.0, 1.0)
        self._memory = self._rows(state[MEMORY]).copy()  # updated by `_run`
        return super()._advance(state, action) | {MEMORY: self._tensor(self._memory)}

    def _run(self, start: NDArray, target: NDArray) -> None:
        if not self._mechanics.active:
            return super()._run(start, target)
        cars, h = self._cars, self.car.timestep
        qpos, qvel = cars.qpos, cars.qvel
        for substep in range(self._substeps):
            middle = self._actuators.lagged(start, target, (substep + 0.5) * h)
            lateral = self._lateral(qpos, qvel)
            rack = self._mechanics.steering(self._memory, middle[:, 1], lateral)
            throttle = self._mechanics.throttle(self._memory, middle[:, 0])
            duty = self._mechanics.duty(self._memory, self._actuators.drive(throttle))
            self._mechanics.drained(self._memory, self._forces.motor_force(qvel, duty))
            angle = self._actuators.steering_angle(rack)
            self._forces.apply(qpos, qvel, cars.xfrc_applied, cars.qfrc_applied, angle, duty)
            cars.step()
        cars.refuse_bad()

    @staticmethod
    def _lateral(qpos: NDArray, qvel: NDArray) -> NDArray:
        """Lateral acceleration [n] [m/s^2] of a steady turn, vx r."""
        motion = read_motion(qpos, qvel)
        return motion.vx * motion.yaw_rate

    def _options(self) -> dict[str, Any]:
        return super()._options() | {"faults": self._faults.given}


def tilted(car: Car, faults: Faults) -> Car:
    """The car on a slope: gravity of the same size, tilted.

    g = (along_x, along_y, -sqrt(G^2 - along_x^2 - along_y^2)).
    """
    x, y = faults["floor_slope.along_x"], faults["floor_slope.along_y"]
    model = copy.copy(car.model)  # the compiled model is shared
    model.opt.gravity[:] = x, y, -np.sqrt(GRAVITY**2 - x * x - y * y)
    return replace(car, model=model)


def with_faults(values: Mapping[str, Tensor], faults: Faults) -> dict[str, Tensor]:
    """The engine's parameters with the faults."""
    changed = dict(values)
    for channel in ("throttle", "steering"):
        if f"{channel}_dead_time" in faults:
            changed[f"{channel}_dead_time"] = (
                values[f"{channel}_dead_time"] + faults[f"{channel}_dead_time.dead_time"]
            )
    if "tire_grip" in faults or "grip_balance" in faults:
        balance = faults["grip_balance.front_to_rear"] ** 0.5
        changed["grip_front"] = values["grip_front"] * faults["tire_grip.grip"] * balance
        changed["grip_rear"] = values["grip_rear"] * faults["tire_grip.grip"] / balance
    if "cornering_stiffness" in faults:
        for axle in ("front", "rear"):
            name = f"cornering_stiffness_{axle}"
            changed[name] = values[name] * faults["cornering_stiffness.ratio"]
    if "payload" in faults:
        load = values["mass"] * (faults["payload.mass_ratio"] - 1.0)
        changed["mass"] = values["mass"] + load
        changed["yaw_inertia"] = values["yaw_inertia"] + load * PAYLOAD_RADIUS**2
    if "top_speed" in faults or "gear_ratio" in faults:
        gear = faults["gear_ratio.ratio"]
        loss = values["drive_speed_loss"] / faults["top_speed.speed_ratio"]
        changed["drive_force"] = gear * values["drive_force"]
        changed["drive_speed_loss"] = gear * gear * loss
    return changed
