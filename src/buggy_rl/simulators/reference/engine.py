"""The reference car as an engine: its state is in the TensorDict, its faults are not.

Not modelled: roll-over, bumps, tyre temperature, the motor's inductance.
"""

from collections.abc import Mapping
from typing import Any, Self

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.parameters import Realisations
from buggy_rl.core.vehicle import (
    Similarity,
    VehicleDimensions,
    rotate,
    shift_velocity,
    similar_dimensions,
)
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.reference.car import ReferenceCar
from buggy_rl.simulators.reference.faults import Faults, as_tensors, refuse_of_another_command
from buggy_rl.simulators.reference.parameters import (
    DIMENSIONS,
    REALISES,
    Build,
    declared_parameters,
)
from buggy_rl.simulators.reference.state import (
    CHARGE,
    DUTY,
    LATENT_SHAPES,
    LEAN,
    LINE,
    RACK,
    SERVO,
    SET_POINT,
    THROTTLE_LAG,
    TYRE_SLIP,
    WHEEL_SLIP,
    CarState,
)

SUBSTEP = 0.001  # [s] of a buggy; halving it moves paths of 1 s by under 1 %, see the tests


class ReferenceEngine(Engine):
    """A double-track car with brush tyres, suspension, motor, battery and servo.

    Args:
        substep: Longest internal step [s]; by default 1 ms of the time of a similar buggy.
        faults: Faults of the car, as `{"effect.parameter": value}` or nested, as
            `{"effect": {"parameter": value}}`, a number for all environments or a tensor of the
            batch's shape; see `faults.FAULTS`.
        compiled: Whether PyTorch compiles the step, which takes seconds and a C++ compiler, and
            makes large batches about three times as fast.
        command: Kind of the first command, as of `single_track`; a one-way throttle by default.
        dimensions: Of another car, or what is known of it; ranges and values are scaled to it.
        speed_ratio: Of its speeds to the buggy's; by default sqrt of the ratio of wheelbases.
        args, common: As for `Engine`.

    Raises:
        KeyError: A parameter or a fault has no such name.
        ValueError: A fault is outside its range, or of another kind of command.
    """

    resets_alone = True
    reach = 2.0  # more duty cycle is more voltage, more command more of the rack's way

    def __init__(
        self,
        *args: Any,
        substep: float | None = None,
        faults: Mapping[str, Any] | None = None,
        compiled: bool = False,
        command: str | Mapping[str, Any] | LongitudinalCommand = "throttle",
        dimensions: VehicleDimensions | Mapping[str, float] | None = None,
        speed_ratio: float | None = None,
        **common: Any,
    ) -> None:
        self.command = LongitudinalCommand.of(command)
        if dimensions is not None and not isinstance(dimensions, VehicleDimensions):
            dimensions = similar_dimensions(dimensions)
        self.dimensions, self.speed_ratio = dimensions, speed_ratio
        size = dimensions or DIMENSIONS
        self.build = Build(size, Similarity.between(size, speed=speed_ratio), self.command)
        declared = declared_parameters(self.command.kind, size, self.build.similarity)
        super().__init__(*args, declared=declared, **common)
        self.substep = SUBSTEP * self.similarity.time if substep is None else substep
        self.compiled = compiled
        self._fault_values = as_tensors(faults, self.device, self.similarity)
        self._substeps = max(1, round(self.dt / self.substep))
        self._parameters_changed()
        self._finish()

    def _nominal(self) -> VehicleDimensions:
        return self.build.dimensions

    @property
    def similarity(self) -> Similarity:
        return self.build.similarity

    def with_faults(self, values: TensorDictBase | Mapping[str, Any]) -> Self:
        """The same car with other faults, one set per environment; unnamed faults stay.

        Args:
            values: As `faults` of the class, in tensors of the batch's shape. A TensorDict's batch
                size becomes the engine's; of a mapping it is that of the longest tensor.

        Raises:
            KeyError: There is no such fault.
            ValueError: A value is outside the range of its fault.
        """
        tensors = as_tensors(values, self.device, self.similarity)
        if isinstance(values, TensorDictBase):
            batch_size = values.batch_size
        else:
            shapes = [tensor.shape for tensor in tensors.values()]
            batch_size = torch.broadcast_shapes(self.batch_size, *shapes)
        engine = self._rebuilt(batch_size)
        engine.values = dict(self.values)
        engine._fault_values |= tensors
        engine._parameters_changed()
        engine._finish()
        return engine

    def _parameters_changed(self) -> None:
        self._fault_values = {n: v.to(self.device) for n, v in self._fault_values.items()}
        values = self._spread_out(self.values)
        faults = Faults(self._spread_out(self._fault_values), values["mass"])
        refuse_of_another_command(faults, self.command.kind)
        self.car = ReferenceCar(values, faults, self.dt, self._substeps, self.compiled, self.build)

    def _spread_out(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        ones = (1,) * len(self.batch_size)
        return {n: v if v.dim() else v.reshape(ones) for n, v in values.items()}

    @property
    def _alike(self) -> bool:
        return super()._alike and not any(value.dim() for value in self._fault_values.values())

    def _latent_specs(self) -> dict[str, TensorSpec]:
        return self._number_specs(LATENT_SHAPES | self.car.fault_shapes)

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        # A car in motion: wheels roll, the motor neither drives nor brakes, and steering, tyres and
        # springs are those of a steady turn with this yaw rate.
        chassis, tyres = self.car.chassis, self.car.tyres
        drivetrain, steering = self.car.drivetrain, self.car.steering
        at_cg = shift_velocity(velocity, -self.build.dimensions.sensor_to_cg)
        vx, vy, yaw_rate = at_cg.unbind(-1)
        servo = self.car.guessed_servo(at_cg)
        cos, sin = steering.directions(servo)
        along, across = chassis.wheel_velocity(vx, vy, yaw_rate, cos, sin)
        transport = tyres.transport_speed(along, across, along)
        slip_speed = torch.stack([torch.zeros_like(across), -across])  # (2, 4, *)
        friction = tyres.friction(chassis.static_load, slip_speed)
        slip = slip_speed / transport
        slip = slip / tyres.strain(slip, friction).clamp_min(1.0)
        charge = (1.0 - self.car.values["initial_charge"]) * self.car.values["capacity"]
        charge = charge.expand_as(vx)
        voltage = drivetrain.open_voltage(charge)
        lean = torch.stack([torch.zeros_like(vx), vx * yaw_rate], -1)
        duty = drivetrain.freewheeling_duty(vx, voltage)
        return {
            WHEEL_SLIP: torch.zeros_like(along).movedim(0, -1),
            TYRE_SLIP: slip.movedim((0, 1), (-2, -1)).contiguous(),
            LEAN: torch.stack([lean, torch.zeros_like(lean)], -2),
            SERVO: servo.unsqueeze(-1),
            DUTY: duty.unsqueeze(-1),
            CHARGE: charge.unsqueeze(-1).clone(),
            **self._rest_fault_state(servo, drivetrain.throttle_at(duty)),
        }

    def _rest_fault_state(self, servo: Tensor, throttle: Tensor) -> dict[str, Tensor]:
        """Latent state of the faults after a steady drive, motor cool and wheel not turned."""
        held = {
            LINE: torch.stack([throttle, servo], -1).unsqueeze(-2),
            THROTTLE_LAG: throttle.unsqueeze(-1),
            RACK: servo.unsqueeze(-1),
            SET_POINT: servo.unsqueeze(-1),
        }
        zero = torch.zeros_like(servo).unsqueeze(-1)
        return {
            name: held.get(name, zero).expand(*servo.shape, *shape).contiguous()
            for name, shape in self.car.fault_shapes.items()
        }

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        car, pose = self._unpacked(state), state[keys.POSE]
        line = state[LINE] if LINE in self.car.fault_shapes else None
        commands, line = self.car.radio.received(line, action)
        self.car.advance(car, commands, pose)
        packed = self._packed(car, pose)
        return packed if line is None else packed | {LINE: line}

    def _unpacked(self, state: TensorDictBase) -> CarState:
        at_cg = shift_velocity(state[keys.VELOCITY], -self.build.dimensions.sensor_to_cg)
        vx, vy, yaw_rate = (part.contiguous() for part in at_cg.unbind(-1))
        servo = state[SERVO].squeeze(-1)
        lean = state[LEAN].movedim((-2, -1), (0, 1)).contiguous()  # (2, 2, *)
        fault_state = {
            n: state[n].movedim(-1, 0) for n in self.car.fault_shapes if n != LINE
        }  # (n, *)
        car = CarState(
            vx=vx,
            vy=vy,
            yaw_rate=yaw_rate,
            dx=torch.zeros_like(vx),
            dy=torch.zeros_like(vx),
            dyaw=torch.zeros_like(vx),
            tread=state[WHEEL_SLIP].movedim(-1, 0),
            slip=state[TYRE_SLIP].movedim((-2, -1), (0, 1)).contiguous(),
            lean=lean[0],
            lean_rate=lean[1],
            servo=servo,
            duty=state[DUTY].squeeze(-1),
            charge=state[CHARGE].squeeze(-1),
            rack=fault_state[RACK][0] if RACK in fault_state else servo,
            fault_state=fault_state,
        )
        car.rack = self.car.steering.linked(car.rack, car.lean[1])
        car.tread = self.car.rolling_speed(car) + car.tread
        return car

    def _packed(self, car: CarState, pose: Tensor) -> dict[str, Tensor]:
        at_cg = torch.stack([car.vx, car.vy, car.yaw_rate], -1)
        # The sensor is ahead of the centre of gravity: its way is that of the centre plus its turn.
        ahead = self.build.dimensions.sensor_to_cg
        way = torch.stack(
            [car.dx + ahead * (torch.cos(car.dyaw) - 1.0), car.dy + ahead * torch.sin(car.dyaw)], -1
        )
        yaw = pose[..., 2]
        position = pose[..., :2] + rotate(way, yaw)
        lean = torch.stack([car.lean, car.lean_rate])  # (2, 2, *)
        return {
            keys.POSE: torch.cat([position, (yaw + car.dyaw).unsqueeze(-1)], -1),
            keys.VELOCITY: shift_velocity(at_cg, ahead),
            WHEEL_SLIP: (car.tread - self.car.rolling_speed(car)).movedim(0, -1),
            TYRE_SLIP: car.slip.movedim((0, 1), (-2, -1)),
            LEAN: lean.movedim((0, 1), (-2, -1)),
            SERVO: car.servo.unsqueeze(-1),
            DUTY: car.duty.unsqueeze(-1),
            CHARGE: car.charge.unsqueeze(-1),
            **{name: value.movedim(0, -1).contiguous() for name, value in car.fault_state.items()},
        }

    @property
    def realises(self) -> Realisations:
        return REALISES

    @property
    def half_step(self) -> dict[str, Any]:
        return {"substep": self.dt / self._substeps / 2}

    def _options(self) -> dict[str, Any]:
        options: dict[str, Any] = {
            "substep": self.substep,
            "faults": self._fault_values,
            "compiled": self.compiled,
        }
        if self.command.plain != "throttle":
            options["command"] = self.command.plain
        car = {"dimensions": self.dimensions, "speed_ratio": self.speed_ratio}
        return options | {name: value for name, value in car.items() if value is not None}
