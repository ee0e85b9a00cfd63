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

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.proof.plants.faults import EFFECTS, PlantFaults
from buggy_rl.proof.plants.mechanics import (
    PUSHES,
    RESTING,
    Mechanics,
    patch_grip,
    push,
    turned_back,
)
from buggy_rl.simulators.mujoco import MujocoEngine
from buggy_rl.simulators.mujoco.car import CompiledCar
from buggy_rl.simulators.mujoco.forces import (
    STOPPING_SPEED,
    ChassisMotion,
    Forces,
    WheelState,
    read_motion,
)
from buggy_rl.simulators.mujoco.weights import DRIVELINE_INERTIA, WHEEL_SPIN_INERTIA

SLOWEST_SHAFT = 0.05  # [m/s] least tread speed of the power limit; chosen


class FaultyForces(Forces):
    """Forces of cars with faults.

    Args:
        car: The model.
        values: Parameter name -> [1] or [n], with the faults.
        faults: Of the car.
    """

    def __init__(
        self, car: CompiledCar, values: Mapping[str, NDArray], faults: PlantFaults
    ) -> None:
        super().__init__(car, values)
        self.faults = faults
        self._floor_grip = self._grip
        wheels = (4 * WHEEL_SPIN_INERTIA + 2 * DRIVELINE_INERTIA) / self.radius**2  # [kg]
        mass = values["mass"]
        self._rolling_share = 1.0 + wheels / mass
        self._bare_mass = mass / faults["payload.mass_ratio"]
        self._half_track = 0.5 * car.dimensions.track_width
        in_front = 1.0 - values["cg_to_front_axle"] / car.dimensions.wheelbase
        self._axle_mass = (mass * in_front, mass * (1.0 - in_front))
        self._pushed = push(
            faults,
            self._rolling_share,
            mass,
            values["yaw_inertia"],
            self._half_track,
            rear_load=GRAVITY * self._axle_mass[1],
        )
        self._pushes = bool((PUSHES | {"torque_steer"}) & faults.active)
        self._turns = bool({"understeer", "dive_steer"} & faults.active)
        self._pulled = 0.0  # yaw acceleration of the substep by the motor's force [rad/s^2]
        self._slope = (faults["floor_slope.along_x"], faults["floor_slope.along_y"])

    def motor_force(self, qvel: NDArray, drive: NDArray) -> NDArray:
        """Force of the motor [n] [N] at a drive [n] in 0..1."""
        loss = self.values["drive_speed_loss"] * self._tread_speed(qvel)
        return drive * (self.values["drive_force"] - loss)

    def apply(self, qpos, qvel, xfrc_applied, qfrc_applied, steering_angle, drive) -> None:
        """Writes the forces, with those of the faults added."""
        if "motor_power_limit" in self.faults:
            drive = self._limited(qvel, drive)
        if "torque_steer" in self.faults:
            moment = -self.faults["torque_steer.offset"] * self.motor_force(qvel, drive)
            self._pulled = moment / self.values["yaw_inertia"]
        if self._turns:
            motor = self.motor_force(qvel, drive)
            steering_angle = steering_angle + self._turned(read_motion(qpos, qvel), motor)
        super().apply(qpos, qvel, xfrc_applied, qfrc_applied, steering_angle, drive)
        if self._pushes:
            self._push(read_motion(qpos, qvel), xfrc_applied)
        if "cornering_drag" in self.faults:
            motion = read_motion(qpos, qvel)
            self._along(motion, -self._scrub * np.tanh(motion.vx / STOPPING_SPEED), xfrc_applied)
        if "steering_drag" in self.faults:
            motion = read_motion(qpos, qvel)
            drag = self.faults["steering_drag.per_angle"] * np.abs(steering_angle)
            drag = drag * self.values["mass"] * self._rolling_share
            self._along(motion, -drag * np.tanh(motion.vx / STOPPING_SPEED), xfrc_applied)

    def tyre_forces(
        self,
        qpos: NDArray,
        qvel: NDArray,
        motion: ChassisMotion,
        wheels: WheelState,
        resistance: NDArray,
    ) -> tuple[NDArray, NDArray]:
        """Forces [4, n] along and across the heading, with the friction of each wheel's place."""
        if "grip_patch" in self.faults:
            x, y = self._wheel_places(qpos, motion)
            self._grip = self._floor_grip * patch_grip(self.faults, x, y)
        if self._pushes or "floor_slope" in self.faults:
            motion = self._end_of_step(motion)
        fx, fy = super().tyre_forces(qpos, qvel, motion, wheels, resistance)
        if "cornering_drag" in self.faults:
            front, rear = self._axle_mass
            axles = (fy[0] + fy[1]) ** 2 / front + (fy[2] + fy[3]) ** 2 / rear
            self._scrub = self.faults["cornering_drag.coefficient"] * self._rolling_share * axles
        return fx, fy

    def _resistance(self, speed: NDArray) -> NDArray:
        resistance = super()._resistance(speed)
        if "rolling_resistance" in self.faults or "viscous_drag" in self.faults:
            dry = self.faults["rolling_resistance.deceleration"] * np.tanh(speed / STOPPING_SPEED)
            slowing = dry + self.faults["viscous_drag.rate"] * speed  # [m/s^2]
            resistance = resistance - self.values["mass"] * self._rolling_share * slowing
        return resistance

    def _accelerations(self, motion: ChassisMotion):
        ax, ay, turning = self._pushed(
            motion.cos, motion.sin, motion.vx, motion.vy, motion.yaw_rate
        )
        return ax, ay, turning + self._pulled

    def _turned(self, motion: ChassisMotion, motor: NDArray) -> NDArray:
        """Angle [n] [rad] of the front wheels beside the servo's."""
        moved = self.values["mass"] * self._rolling_share
        forward = (motor + self._resistance(motion.vx)) / moved
        return turned_back(self.faults, motion.vx, motion.yaw_rate, forward)

    def _end_of_step(self, motion: ChassisMotion) -> ChassisMotion:
        """The motion after the faults' forces of this substep, at the sensor."""
        ax, ay, turning = self._accelerations(motion)
        x, y = self._slope
        ax, ay = ax + motion.cos * x + motion.sin * y, ay + motion.cos * y - motion.sin * x
        return motion._replace(
            vx=motion.vx + self.dt * ax,
            vy=motion.vy + self.dt * (ay - self._cg_x * turning),
            yaw_rate=motion.yaw_rate + self.dt * turning,
        )

    def _push(self, motion: ChassisMotion, xfrc_applied: NDArray) -> None:
        mass, inertia = self.values["mass"], self.values["yaw_inertia"]
        ax, ay, turning = self._accelerations(motion)
        self._along(motion, mass * ax, xfrc_applied)
        body = xfrc_applied[:, self.car.chassis]
        body[:, 0] -= motion.sin * mass * ay
        body[:, 1] += motion.cos * mass * ay
        # A bent rear axle: opposite forces on its hubs.
        damping = -self.faults["yaw_damping.rate"] * motion.yaw_rate
        couple = (turning - damping) * inertia / (2.0 * self._half_track)
        for wheel, side in zip(self.car.wheel_bodies[2:], (-1.0, 1.0), strict=True):
            xfrc_applied[:, wheel, 0] += side * couple * motion.cos
            xfrc_applied[:, wheel, 1] += side * couple * motion.sin
        body[:, 5] = damping * inertia

    def _along(self, motion: ChassisMotion, force: NDArray, xfrc_applied: NDArray) -> None:
        xfrc_applied[:, self.car.chassis, 0] += force * motion.cos
        xfrc_applied[:, self.car.chassis, 1] += force * motion.sin

    def _wheel_places(self, qpos: NDArray, motion: ChassisMotion) -> tuple[NDArray, NDArray]:
        x, y = self.car.hub_x, self.car.hub_y  # (4, 1)
        return (
            qpos[:, 0] + motion.cos * x - motion.sin * y,
            qpos[:, 1] + motion.sin * x + motion.cos * y,
        )

    def _tread_speed(self, qvel: NDArray) -> NDArray:
        return 0.5 * self.radius * qvel[:, self.car.spin[2:]].sum(1)

    def _limited(self, qvel: NDArray, drive: NDArray) -> NDArray:
        """Drive [n] at which d (F - c u) u <= P, u the tread's speed."""
        speed = np.maximum(self._tread_speed(qvel), SLOWEST_SHAFT)
        force = self.values["drive_force"] - self.values["drive_speed_loss"] * speed
        limit = self.faults["motor_power_limit.power_per_mass"] * self._bare_mass
        return np.minimum(drive, limit / np.maximum(force * speed, 1e-6))


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

    resets_alone = False
    _prepared = (*MujocoEngine._prepared, "_faulty", "_mechanics")

    def __init__(
        self, *args: Any, faults: Mapping[str, Mapping[str, float]] | None = None, **options: Any
    ) -> None:
        self._faults = PlantFaults(faults or {}, ABILITIES, "mujoco")
        super().__init__(*args, **options)

    def _prepare(self) -> None:
        faults, nominal = self._faults, self.values
        if "floor_slope" in faults:
            self.car = tilted(self.car, faults)
        self.values = with_faults(nominal, faults)
        super()._prepare()
        self._mechanics = Mechanics(faults, self.car.timestep, TYPICAL_FORCE)
        self._faulty = FaultyForces(self.car, self._forces.values, faults)
        self._forces: Forces = self._faulty
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
        cars: Any = self._cars  # `CpuCars`
        h = self.car.timestep
        qpos, qvel = cars.qpos, cars.qvel
        for substep in range(self._substeps):
            middle = self._actuators.lagged(start, target, (substep + 0.5) * h)
            lateral = self._lateral(qpos, qvel)
            rack = self._mechanics.steering(self._memory, middle[:, 1], lateral)
            throttle = self._mechanics.throttle(self._memory, middle[:, 0])
            duty = self._mechanics.duty(self._memory, self._actuators.drive(throttle))
            self._mechanics.drained(self._memory, self._faulty.motor_force(qvel, duty))
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


def tilted(car: CompiledCar, faults: PlantFaults) -> CompiledCar:
    """The car on a slope: gravity of the same size, tilted.

    g = (along_x, along_y, -sqrt(G^2 - along_x^2 - along_y^2)).
    """
    x, y = faults["floor_slope.along_x"], faults["floor_slope.along_y"]
    model = copy.copy(car.model)  # the compiled model is shared
    model.opt.gravity[:] = x, y, -np.sqrt(GRAVITY**2 - x * x - y * y)
    return replace(car, model=model)


def with_faults(values: Mapping[str, Tensor], faults: PlantFaults) -> dict[str, Tensor]:
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
