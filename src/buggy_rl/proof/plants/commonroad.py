"""The drift single-track car of `commonroad-vehicle-models`, scaled to the buggy, as a plant.

Scaled by geometry and mass, not by a factor: lengths, mass, yaw inertia, wheel radius and height
of the centre of gravity are the buggy's (the library's second car has 1093 kg on 2.58 m); tyre
peaks and slopes over load are DART's (0.84 and 0.85; 6.1 and 9.4 per radian, of which this car's
one tyre has the mean), its shape factors the library's, its combined-slip factors in proportion
to slip over peak slip; the motor pulls 8.5 N standing, about what its rear tyres hold, and reaches
14 m/s without load, which gives the driven 8 to 10 m/s; dry friction is about DART's (1.27 N), the
viscous one a fifth of its 0.74 N s/m, which would end at 5 m/s; servo and radio are of toy size.
None is fitted to data.

The faults are in its inputs (delays, stages of `mechanics`, motor), in its parameters (mass,
inertia, peak friction) and in pushes added to its right-hand side. Not here:
`grip_balance`, because both its axles have one tyre.

Differences from the textbook's parameter: the wheels' inertia makes a slope accelerate the free car
by 10 % less (drags are exact above 0.3 m/s, below which the library blends to a kinematic car
without wheel inertia); at walking pace a lateral slope or wind has no effect; `battery_sag` counts
charge; below 0.1 m/s the library's car follows its wheels, whatever the forces.

The library's equations hold for forward motion; `commonroad_car` describes what replaces them in a
spin and at rest.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.proof.plants.commonroad_car import (
    FRONT_WHEEL,
    REAR_WHEEL,
    SIDESLIP,
    SLOWEST,
    SPEED,
    STANDING,
    STATES,
    STEERING,
    YAW,
    YAW_RATE,
    CommonroadCar,
    library,
)
from buggy_rl.proof.plants.faults import EFFECTS, PlantFaults
from buggy_rl.proof.plants.mechanics import RESTING, Mechanics
from buggy_rl.simulators.base import RowsEngine

ABILITIES = EFFECTS - {"grip_balance"}
COMMANDS = "commands"  # [K, 2] past commands, newest first
ACTUATORS = "actuators"  # [2] throttle behind its lag, road-wheel angle [rad]
WHEEL_SLIP = "wheel_slip"  # [2] circumference less rolling speed, front and rear [m/s]
MEMORY = "plant_memory"  # [len(RESTING)] of `mechanics`
LONGEST_DEAD_TIME = 0.25  # [s] own and fault together
SUBSTEPS = 4  # of a control period; halving the step changes a path of 1 s by under 0.1 %
TYPICAL_FORCE = 1.8  # [N] of the motor, mean of three room drives of 30 s

_OWN = VehicleDimensions()
PARAMETERS = (
    Parameter("mass", _OWN.mass, 0.8, 3.0, "kg", "Whole car."),
    Parameter("yaw_inertia", _OWN.yaw_inertia, 0.002, 0.012, "kg m^2", "Whole car."),
    Parameter("cg_to_front_axle", _OWN.cg_to_front_axle, 0.05, 0.12, "m", "Centre of gravity."),
    Parameter("grip", 0.85, 0.2, 1.5, "-", "Peak friction of a tyre."),
    Parameter("cornering_stiffness", 7.7, 3.0, 25.0, "1/rad", "Lateral force over load, slip."),
    Parameter("slip_stiffness", 13.0, 4.0, 30.0, "-", "Longitudinal force over load and slip."),
    Parameter("steering_lock", 0.36, 0.15, 0.6, "rad", "Road-wheel angle at full command."),
    Parameter("steering_trim", 0.0, -0.1, 0.1, "rad", "Road-wheel angle at zero command."),
    Parameter("steering_lag", 0.06, 0.0, 0.3, "s", "Time constant of the servo."),
    Parameter("steering_rate", 11.0, 1.0, 100.0, "1/s", "Fastest servo, in command."),
    Parameter("steering_dead_time", 0.025, 0.0, 0.08, "s", "Dead time of the servo."),
    Parameter("throttle_lag", 0.05, 0.0, 0.3, "s", "Time constant of the speed controller."),
    Parameter("throttle_dead_time", 0.025, 0.0, 0.08, "s", "Dead time of the speed controller."),
    Parameter("throttle_deadband", 0.15, 0.0, 0.4, "-", "Drive below which none acts."),
    Parameter("drive_force", 8.5, 3.0, 40.0, "N", "Full drive at standstill."),
    Parameter("drive_speed_loss", 0.6, 0.0, 10.0, "N s/m", "Back-EMF, at full drive."),
    Parameter("rolling_resistance", 1.0, 0.0, 5.0, "N", "Dry friction."),
    Parameter("viscous_drag", 0.15, 0.0, 3.0, "N s/m", "Friction that grows with the speed."),
    Parameter("quadratic_drag", 0.02, 0.0, 0.5, "N s^2/m^2", "The air's."),
)


def make_commonroad(
    cars: int, faults: Mapping[str, Mapping[str, float]], parameters: Mapping[str, float] | None
) -> "CommonroadPlant":
    """Cars of the library with faults."""
    return CommonroadPlant(cars, parameters=parameters, faults=faults)


class CommonroadPlant(RowsEngine):
    """Cars of the library, one after the other.

    Args:
        faults: `{effect: {parameter: value}}`.
        substeps: Steps in a control period.
        args, common: As for `Engine`; the library runs on the CPU, whatever the device.

    Raises:
        ModuleNotFoundError: The library is not installed.
        KeyError: There is no such parameter, effect or effect's parameter.
        ValueError: A value is outside its range.
    """

    def __init__(
        self,
        *args: Any,
        faults: Mapping[str, Mapping[str, float]] | None = None,
        substeps: int = SUBSTEPS,
        **common: Any,
    ) -> None:
        library()  # before anything else, so that what is missing is named
        super().__init__(*args, declared=PARAMETERS, **common)
        self._faults = PlantFaults(faults or {}, ABILITIES, "commonroad")
        self.substeps, self._remembered = substeps, math.ceil(LONGEST_DEAD_TIME / self.dt)
        self._parameters_changed()
        self._finish()

    def _parameters_changed(self) -> None:
        count, h = max(self.numel(), 1), self.dt / self.substeps
        own = {
            name: np.broadcast_to(value.reshape(-1).double().cpu().numpy(), (count,))
            for name, value in self.values.items()
        }
        self._own = own
        rows = ({name: float(own[name][car]) for name in own} for car in range(count))
        self._cars = [CommonroadCar(row, self._faults, h) for row in rows]
        self._mechanics = Mechanics(self._faults, h, TYPICAL_FORCE)
        self._weights = {
            channel: command_weights(
                own[f"{channel}_dead_time"] + self._faults[f"{channel}_dead_time.dead_time"],
                self.dt,
                self.substeps,
                self._remembered,
            )
            for channel in ("throttle", "steering")
        }

    def _latent_specs(self) -> dict[str, TensorSpec]:
        shapes = {
            COMMANDS: (self._remembered, 2),
            ACTUATORS: (2,),
            WHEEL_SLIP: (2,),
            MEMORY: (len(RESTING),),
        }
        return self._number_specs(shapes, torch.float64)

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        count = len(self._cars)
        resting = np.array([-1.0, 0.0])
        straight = np.stack([np.full(count, -1.0), self._own["steering_trim"]], -1)
        return {
            COMMANDS: self._tensor(np.tile(resting, (count, self._remembered, 1))),
            ACTUATORS: self._tensor(straight),
            WHEEL_SLIP: self._tensor(np.zeros((count, 2))),
            MEMORY: self._tensor(Mechanics.rest(count)),
        }

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        memory, actuators = self._rows(state[MEMORY]).copy(), self._rows(state[ACTUATORS]).copy()
        trims = (self._faults["throttle_offset.offset"], self._faults["steering_offset.offset"])
        command = np.clip(self._rows(action) + np.array(trims), -1.0, 1.0)
        commands = np.concatenate([command[:, None], self._rows(state[COMMANDS])], 1)
        cars = self._unpacked(state, actuators[:, 1])
        for substep in range(self.substeps):
            self._substep(substep, commands, memory, actuators, cars)
        pose, velocity, slip = self._packed(cars)
        return {
            keys.POSE: self._tensor(pose).float(),
            keys.VELOCITY: self._tensor(velocity).float(),
            COMMANDS: self._tensor(commands[:, :-1]),
            ACTUATORS: self._tensor(np.stack([actuators[:, 0], cars[:, STEERING]], -1)),
            WHEEL_SLIP: self._tensor(slip),
            MEMORY: self._tensor(memory),
        }

    def _substep(
        self, substep: int, commands: NDArray, memory: NDArray, actuators: NDArray, cars: NDArray
    ) -> None:
        own, h, mechanics = self._own, self.dt / self.substeps, self._mechanics
        throttle = (self._weights["throttle"][:, substep] * commands[..., 0]).sum(1)
        steering = (self._weights["steering"][:, substep] * commands[..., 1]).sum(1)
        before = actuators[:, 0].copy()
        actuators[:, 0] = throttle + (before - throttle) * _kept(own["throttle_lag"], h)
        throttle = mechanics.throttle(memory, 0.5 * (before + actuators[:, 0]))
        drive = (0.5 * (throttle + 1.0) - own["throttle_deadband"]) / (
            1.0 - own["throttle_deadband"]
        )
        lateral = cars[:, SPEED] * cars[:, YAW_RATE]
        rack = mechanics.steering(memory, steering, lateral)
        duty = mechanics.duty(memory, np.maximum(drive, 0.0))
        target = own["steering_trim"] + own["steering_lock"] * rack
        asked = (target - cars[:, STEERING]) * (1.0 - _kept(own["steering_lag"], h)) / h
        force = np.empty(len(cars))
        for index, car in enumerate(self._cars):
            tread = cars[index, REAR_WHEEL] * car.radius
            force[index] = car.motor_force(float(duty[index]), tread)
            cars[index] = car.moved(cars[index], float(duty[index]), float(asked[index]))
        mechanics.drained(memory, force)

    def _unpacked(self, state: TensorDictBase, angle: NDArray) -> NDArray:
        """The library's states [n, 9] of what the TensorDict has."""
        pose, velocity = self._rows(state[keys.POSE]), self._rows(state[keys.VELOCITY])
        arm = _OWN.sensor_to_cg
        vx, vy, yaw_rate = velocity[:, 0], velocity[:, 1] - arm * velocity[:, 2], velocity[:, 2]
        cars = np.zeros((len(pose), STATES))
        cars[:, 0] = pose[:, 0] - arm * np.cos(pose[:, 2])
        cars[:, 1] = pose[:, 1] - arm * np.sin(pose[:, 2])
        cars[:, STEERING], cars[:, YAW], cars[:, YAW_RATE] = angle, pose[:, 2], yaw_rate
        # The library's speed has a sign: a car that creeps back has a small sideslip angle.
        speed = np.hypot(vx, vy)
        sign = np.where((vx < 0) & (speed < SLOWEST), -1.0, 1.0)
        cars[:, SPEED] = sign * speed
        resting = [car.kinematic_sideslip(a) for car, a in zip(self._cars, angle, strict=True)]
        cars[:, SIDESLIP] = np.where(speed < STANDING, resting, np.arctan2(sign * vy, sign * vx))
        rolling = self._rolling(cars) + self._rows(state[WHEEL_SLIP])
        cars[:, FRONT_WHEEL:] = np.maximum(rolling, 0.0) / _OWN.wheel_radius
        return cars

    def _packed(self, cars: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        arm, yaw = _OWN.sensor_to_cg, cars[:, YAW]
        pose = np.stack([cars[:, 0] + arm * np.cos(yaw), cars[:, 1] + arm * np.sin(yaw), yaw], -1)
        along, across = np.cos(cars[:, SIDESLIP]), np.sin(cars[:, SIDESLIP])
        speed, yaw_rate = cars[:, SPEED], cars[:, YAW_RATE]
        velocity = np.stack([speed * along, speed * across + arm * yaw_rate, yaw_rate], -1)
        slip = cars[:, FRONT_WHEEL:] * _OWN.wheel_radius - self._rolling(cars)
        return pose, velocity, slip

    def _rolling(self, cars: NDArray) -> NDArray:
        """Speeds [n, 2] of the axles where their wheels point, as the library has them."""
        vx = cars[:, SPEED] * np.cos(cars[:, SIDESLIP])
        vy = cars[:, SPEED] * np.sin(cars[:, SIDESLIP])
        cos, sin = np.cos(cars[:, STEERING]), np.sin(cars[:, STEERING])
        front = vx * cos + (vy + self._own["cg_to_front_axle"] * cars[:, YAW_RATE]) * sin
        return np.maximum(np.stack([front, vx], -1), 0.0)

    def _options(self) -> dict[str, Any]:
        return {"faults": self._faults.given, "substeps": self.substeps}


def command_weights(dead_time: NDArray, dt: float, substeps: int, remembered: int) -> NDArray:
    """Weights [n, S, K + 1] of the past commands in the command of each substep.

    A command k periods old holds over [-k dt, -k dt + dt]; the command of a substep is the mean
    over its own time less the dead time [n].
    """
    h = dt / substeps
    begin = np.arange(substeps)[:, None] * h - dead_time[:, None, None]  # (n, S, 1)
    given = -dt * np.arange(remembered + 1)
    overlap = np.minimum(begin + h, given + dt) - np.maximum(begin, given)
    return np.maximum(overlap, 0.0) / h


def _kept(time_constant: NDArray, h: float) -> NDArray:
    return np.exp(-h / np.maximum(time_constant, 1e-9))
