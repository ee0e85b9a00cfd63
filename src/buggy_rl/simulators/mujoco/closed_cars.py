"""Cars stepped by their equations of motion in closed form: single precision, on any device.

A substep, forces and motion, is one kernel (`core.kernels`) where it is compiled, and PyTorch's
operations where not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from buggy_rl.core.kernels import Kernel
from buggy_rl.core.longitudinal import Kind, LongitudinalCommand, drive_of
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.simulators.mujoco.actuators import (
    Actuators,
    Drive,
    motor_drive,
    servo_angle,
    step_left,
)
from buggy_rl.simulators.mujoco.car import CompiledCar, make_car
from buggy_rl.simulators.mujoco.declared import declared_parameters
from buggy_rl.simulators.mujoco.forces import Forces
from buggy_rl.simulators.mujoco.rigid import RigidCar, read_state, written_state
from buggy_rl.simulators.mujoco.weights import Weights


class Lengths(NamedTuple):
    """What forces and motion ask of `VehicleDimensions`; each of shape ()."""

    wheel_radius: Tensor
    cg_height: Tensor
    cg_to_front_axle: Tensor
    sensor_to_cg: Tensor
    wheelbase: Tensor
    track_width: Tensor


WEIGHTS = tuple(Weights.__dataclass_fields__)


@dataclass(frozen=True)
class CarOfNumbers:
    """A car of any size for `Forces` and `RigidCar`: a `CompiledCar` whose numbers are tensors.

    Args:
        numbers: [K] timestep, `Lengths`, `Weights`, as of `geometry_of`.
        drive: Driven wheels.
    """

    numbers: Tensor
    drive: Drive

    tyres = "explicit"
    chassis, wheel_bodies = 1, range(2, 6)
    slide, spin, steer = map(np.array, ([6, 9, 12, 14], [8, 11, 13, 15], [7, 10]))

    @property
    def timestep(self) -> Any:
        return self.numbers[0]

    @property
    def dimensions(self) -> Any:
        return Lengths(*self.numbers[1 : 1 + len(Lengths._fields)].unbind())

    @property
    def weights(self) -> Weights:
        numbers: Any = self.numbers[1 + len(Lengths._fields) :].unbind()
        return Weights(*numbers)

    @property
    def hub_x(self) -> Tensor:
        size = self.dimensions
        front = size.cg_to_front_axle - size.sensor_to_cg
        rear = front - size.wheelbase
        return torch.stack([front, front, rear, rear])[:, None]

    @property
    def hub_y(self) -> Tensor:
        half = self.dimensions.track_width / 2
        return torch.stack([half, -half, half, -half])[:, None]

    def beside(self, _: Any) -> "CarOfNumbers":
        return self


def geometry_of(car: CompiledCar) -> Tensor:
    """[K] what `CarOfNumbers` is made of."""
    lengths = [getattr(car.dimensions, name) for name in Lengths._fields]
    weights = [getattr(car.weights, name) for name in WEIGHTS]
    return torch.tensor([car.timestep, *lengths, *weights])


def _substep(
    drive: Drive,
    command: LongitudinalCommand,
    names: Sequence[str],
    numbers: Tensor,
    parameters: Tensor,
    target: Tensor,
    lagged: Tensor,
    qpos: Tensor,
    qvel: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Commands behind their lags [2, n], coordinates [n, nq] and speeds [n, nv] a timestep later.

    Args:
        drive: Driven wheels.
        command: What the first command is.
        names: Of the P parameters.
        numbers: [K] of the car.
        parameters: [P, n]
        target: [2, n] throttle and steering command that the lags tend to.
        lagged: [2, n] behind them, in the middle of this timestep.
        qpos: [n, nq]
        qvel: [n, nv]
    """
    car = CarOfNumbers(numbers, drive)
    values = dict(zip(names, parameters.unbind(), strict=True))
    throttle, steering = lagged.unbind()
    angle = servo_angle(values, steering)
    duty = motor_drive(values, command, throttle)
    forces = Forces(car, values, command).applied(qpos, qvel, angle, duty)  # type: ignore[arg-type]
    state = RigidCar(car, values).step(read_state(car, qpos, qvel), forces, angle)
    lags = torch.stack([values["throttle_lag"], values["steering_lag"]])
    lagged = target + (lagged - target) * step_left(lags, car.timestep)
    return lagged, *written_state(car, state, angle)


def _example(drive: Drive, command: LongitudinalCommand, n: int) -> tuple[Tensor, ...]:
    size = VehicleDimensions()
    car = make_car(size, "explicit", 0.0025, visual=False, drive=drive)
    declared = declared_parameters(size, command=command)
    parameters = torch.tensor([p.value for p in declared])[:, None].repeat(1, n)
    qpos = torch.tensor(car.parked, dtype=torch.float32)[:, None].repeat(1, n).T
    qvel = torch.full((car.model.nv, n), 0.1).T
    half = torch.full((2, n), 0.1)
    return geometry_of(car), parameters, half, half.clone(), qpos, qvel


@cache
def substep_kernel(drive: Drive, kind: Kind) -> Kernel:
    """A substep of cars with these driven wheels under this kind of command.

    Its arguments: numbers [K], parameters [P, n], commands and those behind lags [2, n],
    coordinates [n, nq] and speeds [n, nv].
    """
    # A setpoint reaches the kernel as its share of the full one, with reverse or without.
    command = LongitudinalCommand(kind, reverse=kind == "speed")
    names = tuple(p.name for p in declared_parameters(VehicleDimensions(), command=command))
    return Kernel(
        f"mujoco_substep_{drive}_{kind}",
        partial(_substep, drive, command, names),
        partial(_example, drive, command),
        (None, 1, 1, 1, 0, 0),
    )


REAR_DRIVEN = substep_kernel("rear", "throttle")
ALL_DRIVEN = substep_kernel("all", "throttle")
ALL_DRIVEN_TO_SPEED = substep_kernel("all", "speed")
COMPILED = (REAR_DRIVEN, ALL_DRIVEN, ALL_DRIVEN_TO_SPEED)
"""What `scripts/compile.py` compiles: the cars of configs/cars."""


class ClosedCars:
    """See `batches.make_cars` and `batches.Cars`.

    Args:
        car: The model, of explicit tyres.
        count: n.
        values: Parameter name -> [1] or [n].
        command: What the first command is.
        device: Where they are stepped.

    Raises:
        ValueError: The tyres are not explicit.
    """

    dtype = torch.float32

    def __init__(
        self,
        car: CompiledCar,
        count: int,
        values: Mapping[str, Tensor],
        command: LongitudinalCommand,
        device: torch.device,
    ) -> None:
        if car.tyres != "explicit":
            raise ValueError(
                f"backend=closed has no contacts: tyres is {car.tyres!r}, give tyres=explicit or "
                "backend=cpu"
            )
        self.device = device
        self.qpos = torch.tensor(car.parked, dtype=self.dtype, device=device).repeat(count, 1)
        self.qvel = self.qpos.new_zeros(count, car.model.nv)
        self._numbers = geometry_of(car).to(device)
        rows = [self.array(value).expand(count) for value in values.values()]
        self._parameters = torch.stack(rows)
        self._command = command
        self._kernel = substep_kernel(car.drive, command.kind)

    def array(self, tensor: Tensor) -> Tensor:
        return tensor.detach().to(self.device, self.dtype)

    @torch.no_grad()
    def run(
        self, actuators: Actuators, forces: Forces, start: Tensor, target: Tensor, steps: int
    ) -> None:
        if type(forces) is not Forces:
            raise ValueError(
                f"backend=closed has its own forces, not {type(forces).__name__}: give backend=cpu"
            )
        timestep = float(self._numbers[0])
        lagged = actuators.lagged(start, target, 0.5 * timestep)
        if self._command.kind == "speed":  # a lag of a share is the share of the lag
            target, lagged = (
                torch.stack([drive_of(each[:, 0], self._command.rest), each[:, 1]], -1)
                for each in (target, lagged)
            )
        size = (len(self.qpos), 2)
        commands = (target.expand(size).T, lagged.expand(size).T)
        given = (self._numbers, self._parameters, *commands, self.qpos, self.qvel)
        compiled = self._kernel.compiled(self.qpos[:, 0]) if self._kernel in COMPILED else None
        if compiled is not None:
            _, self.qpos, self.qvel = compiled(*given, times=steps)
            return
        for _ in range(steps):
            given = (*given[:3], *self._kernel.function(*given))
        self.qpos, self.qvel = given[-2:]

    def lose_bad(self) -> None:
        pass  # a state that is not finite stays so

    def refuse_bad(self) -> None:
        bad = ~torch.isfinite(self.qpos).all(-1) | ~torch.isfinite(self.qvel).all(-1)
        if bad.any():
            raise RuntimeError(
                f"the state of environment {int(bad.nonzero()[0])} is not finite: its state or its "
                "parameters are outside the range of the physics; check the last pose and velocity"
            )
