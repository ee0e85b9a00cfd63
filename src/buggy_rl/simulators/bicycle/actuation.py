"""Turns commands into road-wheel angle and wheel force: what the two bicycle engines share.

A command passes a dead time, a first-order lag and a static map.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, LongitudinalCommand, command_of, drive_of
from buggy_rl.core.parameters import Added, Realisations, Scaled
from buggy_rl.core.vehicle import (
    Similarity,
    VehicleDimensions,
    integrate_pose,
    shift_velocity,
    similar_dimensions,
)
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.bicycle.longitudinal import (
    LEFT_RIGHT_BLEND,
    law_of,
    resistance,
    steady_drive,
)
from buggy_rl.simulators.bicycle.parameters import ACTUATION, LONGEST_DEAD_TIME, declare

COMMANDS = "commands"  # [K, 2] past throttle and steering commands, newest first
ACTUATOR = "actuator"  # [2] throttle and steering behind dead time and lag

SUBSTEP = 0.005  # [s] longest integration step; two of them in the 10 ms of the car's own rate
SLOWEST_LAG = 1e-6  # [s] stands for no lag, where the formula divides by the time constant
SLOWEST_ARC = 0.5  # [m/s] speed below which no arc follows from a yaw rate; chosen
LEAST_FORCE = 1e-3  # [N] least force of a motor that a drive is divided by


def road_wheel_angle(command: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Road-wheel angle [*] rad of a steering command [*].

    s = command + offset, w = (1 + tanh(30 s)) / 2,
    delta = w a_left tanh(b_left s) + (1 - w) a_right tanh(b_right s).

    Source: DART, Lyons et al., dart_dynamic_models.py.
    """
    s = command + values["steering_offset"]
    to_left = 0.5 * (1 + torch.tanh(LEFT_RIGHT_BLEND * s))
    left = values["left_angle"] * torch.tanh(values["left_steepness"] * s)
    right = values["right_angle"] * torch.tanh(values["right_steepness"] * s)
    return to_left * left + (1 - to_left) * right


def steering_command(angle: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Steering command [*] in [-1, 1] closest to a road-wheel angle [*] rad; inverse of the map."""
    left = angle > 0
    reach = torch.where(left, values["left_angle"], values["right_angle"])
    steepness = torch.where(left, values["left_steepness"], values["right_steepness"])
    share = (angle / reach).clamp(-0.999, 0.999)  # atanh(1) is infinite
    # Not by `torch.atanh`, whose last bit depends on where in the batch a car is.
    atanh = 0.5 * torch.log((1 + share) / (1 - share))
    return (atanh / steepness - values["steering_offset"]).clamp(-1.0, 1.0)


def dead_time_weights(dead_time: Tensor, dt: float, length: int) -> Tensor:
    """Weights of the last commands in the mean command that arrives during a control period.

    The commands are a staircase u_k; late by tau, its mean over a period is
    sum_j max(0, 1 - |j - tau / dt|) u_{k-j}: exact, and continuous in tau.

    Args:
        dead_time: [*] tau [s].
        dt: Control period [s].
        length: How many commands there are, the present one included.

    Returns:
        [*, length] adding up to 1.
    """
    age = torch.arange(length, dtype=dead_time.dtype, device=dead_time.device)
    return (1 - (age - dead_time.unsqueeze(-1) / dt).abs()).clamp_min(0)


def mean_lag_decay(time_constant: Tensor, start: float, end: float) -> Tensor:
    """Mean remaining share of a step over start..end [s] behind a first-order lag.

    y(t) = u + (y(0) - u) exp(-t / T), so its mean is u + (y(0) - u) d with
    d = T (exp(-start / T) - exp(-end / T)) / (end - start).

    Args:
        time_constant: [*] T [s]; 0 is no lag.
        start: Start of the interval [s].
        end: Its end [s]; when equal to `start`, the value at that moment.

    Returns:
        [*] d in 0..1.
    """
    T = time_constant.clamp_min(SLOWEST_LAG)
    if start == end:
        return torch.exp(-start / T)
    return torch.exp(-start / T) * -torch.expm1((start - end) / T) * T / (end - start)


def steady_actuators(
    command: LongitudinalCommand, values: Mapping[str, Tensor], velocity: Tensor
) -> Tensor:
    """Throttle and steering [*, 2] with which a car keeps a velocity [*, 3] of its sensor.

    The motor balances the resistance, the road wheels follow the arc. A standing car has no drive;
    one that rolls back has none either unless its command has reverse.
    """
    v = values
    vx, _, yaw_rate = shift_velocity(velocity, -v["sensor_x"], -v["sensor_y"]).unbind(-1)
    wheelbase = v["cg_to_front_axle"] + v["cg_to_rear_axle"]
    backward = vx < 0 if command.two_way else torch.zeros_like(vx, dtype=torch.bool)
    # A car in reverse is that of its mirrored motion: forward at -vx, with the yaw rate reversed.
    ahead = torch.where(backward, -vx, vx)
    turns = torch.where(backward, -yaw_rate, yaw_rate)
    angle = torch.atan(wheelbase * turns / ahead.clamp_min(SLOWEST_ARC))
    needed = resistance(ahead, angle, v)
    drive = _drive(command, v, ahead, needed, backward) * (ahead > 0)
    drive = torch.where(backward, -drive.clamp(0.0, 1.0), drive.clamp(0.0, 1.0))
    return torch.stack([command_of(drive, command.rest), steering_command(angle, v)], -1)


def _drive(
    command: LongitudinalCommand,
    v: Mapping[str, Tensor],
    ahead: Tensor,
    needed: Tensor,
    backward: Tensor,
) -> Tensor:
    """Size of the drive [*] that balances a resistance [*] N at a speed [*] m/s; not clamped."""
    if command.kind == "speed":
        return steady_drive(ahead, needed, v)
    if command.kind == "current":
        return needed / v["drive_force"].clamp_min(LEAST_FORCE)
    available = (v["drive_force"] - v["drive_force_loss"] * ahead).clamp_min(LEAST_FORCE)
    forward = v["throttle_deadband"] + needed / available
    if not command.two_way:
        return forward
    reverse = (available * v["reverse_share"]).clamp_min(LEAST_FORCE)
    return torch.where(backward, v["reverse_deadband"] + needed / reverse, forward)


def moved_on(
    substep: Callable[[Tensor, Tensor, Tensor, Any], Tensor],
    values: Mapping[str, Tensor],
    actuators: Iterable[Tensor],
    motion: tuple[Tensor, Tensor],
    h: Any,
    rest: float = ONE_WAY_REST,
) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] of the sensor after a substep of `h` [s] with each of the actuators.

    Args:
        substep: Velocity of the centre of gravity at the end of one, see `ActuatedEngine._substep`.
        values: Of the parameters.
        actuators: Throttle and steering [*, 2] of each, constant at their mean.
        motion: Pose and velocity at the start.
        h: [s]
        rest: Throttle without drive.
    """
    pose, velocity = motion
    for position in actuators:
        throttle, steering = position.unbind(-1)
        angle = road_wheel_angle(steering, values)
        at_cg = shift_velocity(velocity, -values["sensor_x"], -values["sensor_y"])
        at_cg = substep(at_cg, drive_of(throttle, rest), angle, h)
        moved = shift_velocity(at_cg, values["sensor_x"], values["sensor_y"])
        pose, velocity = integrate_pose(pose, velocity, moved, h), moved
    return pose, velocity


class ActuatedEngine(Engine):
    """A bicycle model behind dead times and lags; a subclass integrates its velocity.

    Within a substep the actuators are constant at their mean: exact for a constant command, of
    second order for a changing one.

    Args:
        preset: Parameter set: `buggy`, `dart` or `dart_lag`.
        substeps: Integration steps in a control period; None for as few as are no longer than
            `SUBSTEP`.
        command: Kind of the first command, by name or as a mapping of the fields of
            `LongitudinalCommand`: `throttle`; `throttle_brake_reverse`; `speed`, with
            `reverse: true` if it may be negative; `current`.
        dimensions: Of another car, or what is known of it; ranges and values are scaled to it.
        speed_ratio: Of its speeds to the buggy's; by default sqrt of the ratio of wheelbases.
        args, common: As for `Engine`; `parameters` differ from the preset's.

    Raises:
        ValueError: The preset is unknown, or `substeps` is not positive.
        KeyError: A parameter is unknown.
    """

    resets_alone = True
    reach = 2.0  # its maps from command to force and angle are formulas, beyond 1 as below
    own_parameters: tuple = ()
    """Rows like those of `ACTUATION`, of a subclass's further parameters."""

    def __init__(
        self,
        *args: Any,
        preset: str = "buggy",
        substeps: int | None = None,
        command: str | Mapping[str, Any] | LongitudinalCommand = "throttle",
        dimensions: VehicleDimensions | Mapping[str, float] | None = None,
        speed_ratio: float | None = None,
        **common: Any,
    ) -> None:
        if substeps is not None and substeps < 1:
            raise ValueError(f"substeps is {substeps}: at least 1 is needed")
        if dimensions is not None and not isinstance(dimensions, VehicleDimensions):
            dimensions = similar_dimensions(dimensions)
        self.dimensions, self.speed_ratio = dimensions, speed_ratio
        self.command = LongitudinalCommand.of(command)
        self.law = law_of(self.command)
        rows = self._parameter_rows()
        declared = declare(preset, rows, dimensions, speed_ratio)
        super().__init__(*args, declared=declared, **common)
        self.preset = preset
        self.substeps = substeps or math.ceil(self.dt / SUBSTEP - 1e-6)
        self._remembered = math.ceil(LONGEST_DEAD_TIME / self.dt)  # past commands kept
        self._finish()
        self._parameters_changed()

    @abstractmethod
    def _substep(self, velocity: Tensor, drive: Tensor, steering_angle: Tensor, h: float) -> Tensor:
        """Velocity [*, 3] of the centre of gravity `h` seconds later, with constant actuators."""

    def vehicle(self) -> VehicleDimensions:
        front, rear, ahead = self._named("cg_to_front_axle", "cg_to_rear_axle", "sensor_x").values()
        return replace(super().vehicle(), wheelbase=round(front + rear, 6), sensor_to_cg=ahead)

    def _parameter_rows(self) -> tuple:
        rows = (*self.own_parameters, *ACTUATION)
        return (*(r for r in rows if r[0] not in self.law.replaced), *self.law.parameters)

    @property
    def realises(self) -> Realisations:
        found: dict[str, tuple] = {
            "throttle_dead_time": (Added("throttle_dead_time", "dead_time"),),
            "steering_dead_time": (Added("steering_dead_time", "dead_time"),),
            "viscous_drag": (Added("viscous_friction", "rate", self.declared["mass"].value),),
        }
        if "drive_force_loss" in self.declared:  # of a throttle, behind which is a motor's law
            found["top_speed"] = (Scaled("drive_force_loss", "speed_ratio", -1.0),)
        return found

    def _nominal(self) -> VehicleDimensions:
        return self.dimensions or super()._nominal()

    @property
    def similarity(self) -> Similarity:
        return Similarity.between(self._nominal(), speed=self.speed_ratio)

    @property
    def half_step(self) -> dict[str, Any]:
        return {"substeps": 2 * self.substeps}

    def _latent_specs(self) -> dict[str, TensorSpec]:
        return self._number_specs({COMMANDS: (self._remembered, 2), ACTUATOR: (2,)})

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        held = steady_actuators(self.command, self.values, velocity)  # (*, 2)
        commands = held.unsqueeze(-2).repeat_interleave(self._remembered, -2)
        return {COMMANDS: commands, ACTUATOR: held}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        commands = torch.cat([action.unsqueeze(-2), state[COMMANDS]], -2)  # (*, K + 1, 2)
        arriving = commands.gather(-2, self._arriving.expand(*commands.shape[:-2], 2, 2))
        earlier, later = (self._weights * arriving).unbind(-2)
        target = earlier + later  # (*, 2)
        to_go = state[ACTUATOR] - target
        actuators = [target + to_go * decay for decay in self._mean_decays]
        pose, velocity = self._moved_on(actuators, state[keys.POSE], state[keys.VELOCITY])
        return {
            keys.POSE: pose,
            keys.VELOCITY: velocity,
            COMMANDS: commands[..., :-1, :],
            ACTUATOR: target + to_go * self._end_decay,
        }

    def _moved_on(
        self, actuators: Sequence[Tensor], pose: Tensor, velocity: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Pose and velocity after a substep with each of the actuators' positions [*, 2]."""
        h = self.dt / self.substeps
        return moved_on(
            self._substep, self.values, actuators, (pose, velocity), h, self.command.rest
        )

    def _parameters_changed(self) -> None:
        dead_time = self._both("dead_time")
        if not bool(((dead_time >= 0) & (dead_time <= LONGEST_DEAD_TIME)).all()):
            raise ValueError(
                f"a dead time is outside 0..{LONGEST_DEAD_TIME} s, the length of the memory of "
                f"commands: throttle {self.values['throttle_dead_time'].tolist()}, "
                f"steering {self.values['steering_dead_time'].tolist()}"
            )
        weights = dead_time_weights(dead_time, self.dt, self._remembered + 1).mT  # (*, K + 1, 2)
        # Two commands arrive in a period. A sum over all K + 1 is compiled to a parallel region
        # for each environment: with two threads 18 to 31 times slower (torch 2.13).
        first = (dead_time / self.dt).floor().long().clamp_max(self._remembered - 1)  # (*, 2)
        self._arriving = torch.stack([first, first + 1], -2)  # (*, 2, 2) rows of each channel
        self._weights = weights.gather(-2, self._arriving)
        lag, h = self._both("lag"), self.dt / self.substeps
        self._mean_decays = [mean_lag_decay(lag, i * h, (i + 1) * h) for i in range(self.substeps)]
        self._end_decay = mean_lag_decay(lag, self.dt, self.dt)

    def _both(self, what: str) -> Tensor:
        """A parameter of both actuators, [*, 2]."""
        return self._pair("throttle", "steering", what)

    def _pair(self, first: str, second: str, what: str) -> Tensor:
        """Two parameters side by side, [*, 2]."""
        return side_by_side(self.values[f"{first}_{what}"], self.values[f"{second}_{what}"])

    def _options(self) -> dict[str, Any]:
        options: dict[str, Any] = {"preset": self.preset, "substeps": self.substeps}
        if self.command.plain != "throttle":
            options["command"] = self.command.plain
        car = {"dimensions": self.dimensions, "speed_ratio": self.speed_ratio}
        return options | {name: value for name, value in car.items() if value is not None}


def side_by_side(first: Tensor, second: Tensor) -> Tensor:
    """Two values of shape () or [*] in one tensor [*, 2]."""
    return torch.stack(torch.broadcast_tensors(first, second), -1)
