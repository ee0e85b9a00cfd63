"""The reference car: its parts and their forces on one another in one substep."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import torch
from torch import Tensor

from buggy_rl.core.kernels import Kernel
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.vehicle import GRAVITY, slip_angle
from buggy_rl.simulators.reference.chassis import Chassis
from buggy_rl.simulators.reference.drivetrain import Drivetrain
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.parameters import COMMANDED, PARAMETERS, Build
from buggy_rl.simulators.reference.state import (
    FAULT_STATES,
    GIVES,
    HEAT,
    LINE,
    STICKS,
    WHEEL_TURN,
    CarState,
    Setting,
)
from buggy_rl.simulators.reference.steering import Radio, SteeringServo
from buggy_rl.simulators.reference.surroundings import Supply, Surroundings
from buggy_rl.simulators.reference.two_way import TwoWayDrivetrain
from buggy_rl.simulators.reference.tyres import Tyres

BRAKED = LongitudinalCommand("throttle_brake_reverse")
VALUES = tuple(parameter.name for parameter in PARAMETERS)
BRAKED_VALUES = (*VALUES, *(parameter.name for parameter in COMMANDED[BRAKED.kind]))
MOVED = (
    *("vx", "vy", "yaw_rate", "dx", "dy", "dyaw"),
    *("tread", "slip", "lean", "lean_rate", "servo", "duty", "charge"),
)
"""The state of a car without a fault, which has no play either."""
TURNING = ("bump_steer", "dive_steer", "understeer", "wheel_wobble")
"""Faults that turn the front wheels beside the linkage."""
GUESS_SPEED = (
    0.3  # [m/s] speed below which the steering of a buggy is not read off the velocity; chosen
)


class ReferenceCar:
    """The parts of the car, batched.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        faults: Of the car.
        dt: Control period [s].
        substeps: In a control period.
        compiled: Whether PyTorch compiles a substep where there is no kernel of it.
        build: Size and command of the car.
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        faults: Faults,
        dt: float,
        substeps: int,
        compiled: bool = False,
        build: Build | None = None,
    ) -> None:
        self.build = build or Build()
        size, scale, self.command = self.build.parts
        self.values, self.faults, self.substeps = values, faults, substeps
        self._step = _compiled_step() if compiled else ReferenceCar.step
        self._side_by_side = torch.empty(0, 0)  # of another shape than of any cars, one alone too
        self.substep = dt / substeps
        self.radio = Radio(faults, dt, substeps)
        self.chassis = Chassis(values, size, faults, scale)
        self.tyres = Tyres(values, self.chassis.static_load, faults, scale)
        if self.command.kind == "throttle":
            make = partial(Drivetrain, values, size.wheel_radius)
        else:
            make = partial(TwoWayDrivetrain, self.build, values)
        self.drivetrain = make(self.chassis, faults, self.substep)
        self.supply = Supply(faults, self.command, self.substep)
        self.steering = SteeringServo(
            values, size.track_width, size.wheelbase, faults, self.substep
        )
        self.surroundings = Surroundings(
            values, self.chassis, self.drivetrain.rolling_mass, size.sensor_to_cg, faults
        )
        self.guess_speed = scale.speed * GUESS_SPEED
        self.fault_shapes: dict[str, tuple[int, ...]] = {
            name: shape for name, (shape, fault) in FAULT_STATES.items() if fault in faults
        }
        if self.radio.late:
            self.fault_shapes[LINE] = (self.radio.kept, 2)

    def advance(self, car: CarState, commands: Tensor, pose: Tensor) -> None:
        """Advances the car by a control period.

        Args:
            car: Its state, which is replaced.
            commands: [S or 1, 2, *] throttle and steering as `Radio.received` gives them.
            pose: [*, 3] of the sensor at the start.
        """
        throttle, steering = commands[0]
        setting = Setting(
            throttle=throttle,
            steering=steering,
            duty=self.drivetrain.target_duty(throttle),
            voltage=self.drivetrain.open_voltage(car.charge),
            pose=pose,
        )
        kernel = self.kernel if len(commands) == 1 else None
        substep = None if kernel is None else kernel.compiled(car.vx)
        if substep is not None:
            self._compiled_steps(substep, kernel is KERNEL, car, setting)
            return
        for index in range(self.substeps):
            if 0 < index < len(commands):
                setting.throttle, setting.steering = commands[index]
                setting.duty = self.drivetrain.target_duty(setting.throttle)
            self._step(self, car, setting, self.substep)

    @property
    def kernel(self) -> Kernel | None:
        """Kernel of its substep; without one PyTorch steps it."""
        if self.faults.active:
            return None
        if self.build.usual:
            return KERNEL
        return BRAKED_KERNEL if self.build.command == BRAKED else None

    def _compiled_steps(
        self,
        substep: Callable[..., Sequence[Tensor]],
        usual: bool,
        car: CarState,
        setting: Setting,
    ) -> None:
        """All substeps of a control period by the kernel of a usual build, or of another."""
        if self._side_by_side.shape[1:] != car.vx.shape:
            names = VALUES if usual else BRAKED_VALUES
            self._side_by_side = torch.stack([self.values[n].expand_as(car.vx) for n in names])
        size = () if usual else (self.build.numbers(car.vx),)
        given = (setting.steering, setting.duty, setting.voltage)
        fixed = (self._side_by_side, *size, car.vx.new_tensor(self.substep), *given)
        state = substep(*fixed, *(getattr(car, n) for n in MOVED), times=self.substeps)
        for name, value in zip(MOVED, state, strict=True):
            setattr(car, name, value)
        car.rack = car.servo

    def step(self, car: CarState, setting: Setting, dt: float) -> None:
        """Moves `car` on by `dt` [s]."""
        chassis, tyres, drivetrain = self.chassis, self.tyres, self.drivetrain
        faults, fault_state, surroundings = self.faults, car.fault_state, self.surroundings
        steering, target = setting.steering, setting.duty
        if "steering_dead_zone" in faults:
            steering = self.steering.centred(steering)
        if "steering_lag" in faults:
            steering = self.steering.smoothed(fault_state, steering)
        if "sticky_servo" in faults:
            steering = self.steering.unstuck(fault_state, car.servo, steering)
        if "servo_stiction" in faults:
            steering = self.steering.unstuck(fault_state, car.servo, steering, STICKS)
        if "throttle_lag" in faults:
            target = drivetrain.target_duty(drivetrain.filtered(fault_state, setting.throttle))
        servo = self.steering.moved(car.servo, steering, dt)
        rack = (
            self.steering.followed(fault_state, servo) if "steering_backlash" in faults else servo
        )
        rack = self.steering.linked(rack, car.lean[1])
        duty = drivetrain.slewed(car.duty, target, dt)

        cos, sin = self.steering.directions(0.5 * (car.rack + rack), self._turned(car))
        along, across = chassis.wheel_velocity(car.vx, car.vy, car.yaw_rate, cos, sin)
        slip_speed = torch.stack([car.tread - along, -across])  # (2, 4, *)
        transport = tyres.transport_speed(along, across, car.tread)
        slip, effective = tyres.relaxed(car.slip, slip_speed, transport, dt)
        load = chassis.loads(car.lean, car.lean_rate)
        friction = tyres.friction(load, slip_speed)
        if surroundings.patchy:
            friction = friction * surroundings.grip(car, setting.pose)
        strain = tyres.strain(effective, friction)
        force = tyres.force(effective, load, strain)
        car.slip = slip / strain.clamp_min(1.0)  # a sliding contact deforms its carcass no further

        asked = 0.5 * (car.duty + duty)
        if self.supply.weak:
            asked = self.supply.left(fault_state, asked, setting.throttle, car.servo, servo)
        heat = fault_state[HEAT].squeeze(0) if "heating_motor" in faults else None
        mean_duty, current = drivetrain.motor(asked, car, setting, heat)
        brakes = drivetrain.brakes(asked, target, car)
        car.charge = drivetrain.drained(car.charge, mean_duty, current, dt)
        if heat is not None:
            drivetrain.warmed(fault_state, current, dt)
        twist = self._twist(fault_state, current)
        turned = self.steering.angle(rack) if "steering_drag" in faults else None
        car.tread = drivetrain.spun(car.tread, force, load, current, dt, twist, brakes, turned)
        if "understeer" in faults:
            self.steering.given_way(fault_state, force[1, :2].sum(0) / chassis.front_mass)
        if "wheel_wobble" in faults:
            turn = fault_state[WHEEL_TURN] + car.tread[0] * (
                dt / self.build.dimensions.wheel_radius
            )
            fault_state[WHEEL_TURN] = torch.remainder(turn, 2.0 * math.pi)

        ax, ay, yaw_acceleration = chassis.acceleration(force, cos, sin, car.vx, car.vy)
        car.lean, car.lean_rate = chassis.leaned(car.lean, car.lean_rate, torch.stack([ax, ay]), dt)
        car.servo, car.duty, car.rack = servo, duty, rack
        if surroundings.pushes:
            push_x, push_y, scrub = surroundings.push(car, setting.pose)
            ax, ay, yaw_acceleration = ax + push_x, ay + push_y, yaw_acceleration + scrub
        self._moved(car, ax, ay, yaw_acceleration, dt)

    def _twist(self, fault_state: dict[str, Tensor], current: Tensor) -> Tensor | None:
        """Motor current [*] [A] that the left half of the rear axle gets above its share."""
        twist = None
        if "loose_differential" in self.faults:
            twist = self.drivetrain.twisted(fault_state, current)
        if "torque_steer" in self.faults:
            more = self.drivetrain.beside * current
            twist = more if twist is None else twist + more
        return twist

    def _turned(self, car: CarState) -> Tensor | None:
        """Angle of each front wheel [2, *] [rad] beside the linkage's: by forces, a bent rim."""
        faults = self.faults
        if not any(name in faults for name in TURNING):
            return None
        right = faults["bump_steer.angle"] * car.lean[1] + faults["dive_steer.angle"] * car.lean[0]
        if "understeer" in faults:
            right = right - car.fault_state[GIVES].squeeze(0)
        if "wheel_wobble" not in faults:
            return torch.stack([right, right])
        wobble = faults["wheel_wobble.angle"] * torch.sin(car.fault_state[WHEEL_TURN].squeeze(0))
        return torch.stack([right + wobble, right])

    def _moved(
        self,
        car: CarState,
        ax: Tensor,
        ay: Tensor,
        yaw_acceleration: Tensor,
        dt: float,
    ) -> None:
        cos, sin = torch.cos(car.dyaw), torch.sin(car.dyaw)
        yaw_rate = car.yaw_rate + dt * yaw_acceleration
        turn = 0.5 * dt * (car.yaw_rate + yaw_rate)
        # dvx/dt = ax + r vy, dvy/dt = ay - r vx, semi-implicitly: the rotation alone then does not
        # increase the speed.
        vx = car.vx + dt * ax + turn * car.vy
        vy = car.vy + dt * ay - turn * vx
        mean_x, mean_y = 0.5 * dt * (car.vx + vx), 0.5 * dt * (car.vy + vy)
        car.dx = car.dx + cos * mean_x - sin * mean_y
        car.dy = car.dy + sin * mean_x + cos * mean_y
        car.dyaw = car.dyaw + turn
        car.vx, car.vy, car.yaw_rate = vx, vy, yaw_rate

    def rolling_speed(self, car: CarState) -> Tensor:
        """Ground speed [4, *] [m/s] along each wheel."""
        cos, sin = self.steering.directions(car.rack, self._turned(car))
        return self.chassis.wheel_velocity(car.vx, car.vy, car.yaw_rate, cos, sin)[0]

    def guessed_servo(self, velocity: Tensor) -> Tensor:
        """Estimates the servo position [*] from the velocity [*, 3] of the centre of gravity.

        Front wheels point where their axle moves, plus the slip angle of a steady turn.
        """
        vx, _, yaw_rate = velocity.unbind(-1)
        needed = vx * yaw_rate / (GRAVITY * self.values["front_cornering_stiffness"])
        angle = slip_angle(velocity, 0.0, self.values["cg_to_front_axle"]) + needed
        if self.command.two_way:  # in reverse the wheels point against where their axle moves
            angle = torch.where(vx < 0, -angle, angle)
        weight = vx.square() / (vx.square() + self.guess_speed**2)
        return weight * self.steering.servo_at(angle)


@cache
def _compiled_step() -> Callable[[ReferenceCar, CarState, Setting, float], None]:
    return torch.compile(ReferenceCar.step, dynamic=True)


def _moved_on(
    values: Tensor, dt: Any, steering: Tensor, duty: Tensor, voltage: Tensor, *state: Tensor
) -> tuple[Tensor, ...]:
    """A substep of `dt` [s] of cars without a fault, `values` [P, n] in the order of `VALUES`."""
    named = dict(zip(VALUES, values.unbind(), strict=True))
    return _stepped(
        ReferenceCar(named, Faults({}, values[0]), dt, 1), steering, duty, voltage, *state
    )


def _braked_on(
    values: Tensor,
    size: Tensor,
    dt: Any,
    steering: Tensor,
    duty: Tensor,
    voltage: Tensor,
    *state: Tensor,
) -> tuple[Tensor, ...]:
    """A substep of cars of any size with brakes, `values` [P, n] in the order of `BRAKED_VALUES`.

    `size` [S] is `Build.numbers`.
    """
    named = dict(zip(BRAKED_VALUES, values.unbind(), strict=True))
    build = Build.of_numbers(size, BRAKED)
    parts = ReferenceCar(named, Faults({}, values[0]), dt, 1, build=build)
    return _stepped(parts, steering, duty, voltage, *state)


def _stepped(
    parts: ReferenceCar, steering: Tensor, duty: Tensor, voltage: Tensor, *state: Tensor
) -> tuple[Tensor, ...]:
    moved: dict[str, Any] = dict(zip(MOVED, state, strict=True))
    car = CarState(**moved, rack=moved["servo"])
    setting = Setting(steering, steering, duty, voltage, pose=steering)
    parts.step(car, setting, parts.substep)
    return tuple(getattr(car, name) for name in MOVED)


def _example(n: int) -> tuple[Tensor, ...]:
    values = torch.tensor([parameter.value for parameter in PARAMETERS])
    zero, one = torch.zeros(n), torch.ones(n)
    state = {"vx": one, "tread": torch.ones(4, n), "slip": torch.zeros(2, 4, n)}
    state |= {"lean": torch.zeros(2, n), "lean_rate": torch.zeros(2, n)}
    own = (state.get(name, zero).clone() for name in MOVED)
    return (values[:, None].repeat(1, n), torch.tensor(0.001), zero, zero.clone(), 7 * one, *own)


def _braked_example(n: int) -> tuple[Tensor, ...]:
    _, *rest = _example(n)
    shipped = {p.name: p.value for p in (*PARAMETERS, *COMMANDED[BRAKED.kind])}
    values = torch.tensor([shipped[name] for name in BRAKED_VALUES])
    return (values[:, None].repeat(1, n), Build().numbers(values), *rest)


DIMENSION = {"tread": 1, "slip": 2, "lean": 1, "lean_rate": 1}  # of the cars; else 0
STATE = tuple(DIMENSION.get(name, 0) for name in MOVED)
# The buggy's has its dimensions as constants, as it had before there were other sizes.
KERNEL = Kernel("reference_substep", _moved_on, _example, (1, None, 0, 0, 0, *STATE))
BRAKED_KERNEL = Kernel(
    "reference_substep_braked", _braked_on, _braked_example, (1, None, None, 0, 0, 0, *STATE)
)
