"""From commands to road-wheel angle and wheel force: what the two bicycle engines share.

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

from buggy_rl import keys
from buggy_rl.engines.base import Engine
from buggy_rl.engines.delays import dead_time_weights, lag_decay
from buggy_rl.engines.longitudinal_force import law_of
from buggy_rl.engines.preset import declare
from buggy_rl.engines.steady import steady_actuators
from buggy_rl.engines.steering_map import road_wheel_angle
from buggy_rl.longitudinal import ONE_WAY_REST, LongitudinalCommand, drive_of
from buggy_rl.realisation import Added, Realisations, Scaled
from buggy_rl.similarity import Similarity, similar_dimensions
from buggy_rl.vehicle import VehicleDimensions, integrate_pose, shift_velocity

COMMANDS = "commands"  # [K, 2] past throttle and steering commands, newest first
ACTUATOR = "actuator"  # [2] throttle and steering behind dead time and lag

SUBSTEP = 0.005  # [s] longest integration step; two of them in the 10 ms of the car's own rate
LONGEST_DEAD_TIME = 0.25  # [s] length of the memory `commands`; DART's longest dead time is 0.14 s

# name, lower, upper, unit, meaning; values are in presets/*.yaml
ACTUATION = (
    ("cg_to_front_axle", 0.02, 0.5, "m", "Centre of gravity to front axle."),
    ("cg_to_rear_axle", 0.02, 0.5, "m", "Centre of gravity to rear axle."),
    ("sensor_x", -0.3, 0.3, "m", "Tracking sensor ahead of the centre of gravity."),
    ("sensor_y", -0.3, 0.3, "m", "Tracking sensor to the left of the centre of gravity."),
    ("mass", 0.3, 10.0, "kg", "Mass of the whole car."),
    ("drive_force", 0.0, 100.0, "N", "Force of the motor at standstill and full drive."),
    ("drive_force_loss", 0.0, 20.0, "N s/m", "Force the motor loses to back-EMF per speed."),
    ("throttle_deadband", 0.0, 0.5, "-", "Drive (0..1) below which the motor does nothing."),
    ("dry_friction", 0.0, 10.0, "N", "Friction that does not depend on speed."),
    ("dry_friction_steepness", 0.5, 50.0, "s/m", "Inverse speed at which dry friction is at 76 %."),
    ("viscous_friction", 0.0, 5.0, "N s/m", "Friction that grows with speed."),
    ("quadratic_drag", -0.5, 2.0, "N s^2/m^2", "Resistance that grows with speed squared."),
    ("steering_drag", 0.0, 20.0, "N/rad", "Extra resistance per road-wheel angle."),
    ("steering_drag_speed", 0.0, 10.0, "N s/(m rad)", "Growth of the steering drag with speed."),
    ("steering_drag_free_angle", 0.0, 0.2, "rad", "Road-wheel angle at which that drag begins."),
    ("left_angle", 0.05, 1.0, "rad", "Asymptote of the road-wheel angle to the left."),
    ("left_steepness", 0.1, 5.0, "-", "Steepness of the steering map to the left."),
    ("right_angle", 0.05, 1.0, "rad", "Asymptote of the road-wheel angle to the right."),
    ("right_steepness", 0.1, 5.0, "-", "Steepness of the steering map to the right."),
    ("steering_offset", -0.3, 0.3, "-", "Added to the steering command by the linkage."),
    ("throttle_dead_time", 0.0, LONGEST_DEAD_TIME, "s", "Delay until the throttle acts."),
    ("throttle_lag", 0.0, 1.0, "s", "Time constant of the throttle behind that."),
    ("steering_dead_time", 0.0, LONGEST_DEAD_TIME, "s", "Delay until the steering acts."),
    ("steering_lag", 0.0, 1.0, "s", "Time constant of the steering behind that."),
)


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
        target = (self._weights * arriving).sum(-2)  # (*, 2)
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
        self._mean_decays = [lag_decay(lag, i * h, (i + 1) * h) for i in range(self.substeps)]
        self._end_decay = lag_decay(lag, self.dt, self.dt)

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
