"""The reference car as an engine: what its parts do in one substep, and its latent state.

Not modelled: roll-over, bumps, tyre temperature, the motor's inductance, reverse.
"""

from collections.abc import Mapping, Sequence
from typing import Self

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from buggy_rl import keys
from buggy_rl.engines.base import Engine
from buggy_rl.engines.reference.chassis import Chassis
from buggy_rl.engines.reference.drivetrain import Drivetrain
from buggy_rl.engines.reference.parameters import DIMENSIONS, PARAMETERS
from buggy_rl.engines.reference.state import (
    CHARGE,
    DUTY,
    LATENT_SHAPES,
    LEAN,
    SERVO,
    TYRE_SLIP,
    WHEEL_SLIP,
    CarState,
    Setting,
)
from buggy_rl.engines.reference.steering import Steering
from buggy_rl.engines.reference.tyres import Tyres
from buggy_rl.vehicle import CONTROL_PERIOD, GRAVITY, rotate, shift_velocity, slip_angle

SUBSTEP = 0.001  # [s] halving it moves paths of 1 s by under 1 %, see the tests
GUESS_SPEED = 0.3  # [m/s] below it a velocity says little about the steering; chosen


class ReferenceEngine(Engine):
    """A double-track car with brush tyres, suspension, motor, battery and servo.

    Args:
        batch_size: Number of cars, or a shape; () for a single car.
        device: Where the state lives.
        parameters: Values that differ from `PARAMETERS`, by name.
        dt: Control period [s].
        substep: Longest internal step [s].
    """

    def __init__(
        self,
        batch_size: int | Sequence[int] = (),
        device: torch.device | str = "cpu",
        parameters: Mapping[str, float] | None = None,
        dt: float = CONTROL_PERIOD,
        substep: float = SUBSTEP,
    ) -> None:
        super().__init__(batch_size, device, parameters, dt, declared=PARAMETERS)
        self.substep = substep
        self._substeps = max(1, round(dt / substep))
        self._parameters_changed()
        self._finish()

    def _parameters_changed(self) -> None:
        ones = (1,) * len(self.batch_size)
        values = {
            name: value if value.dim() else value.reshape(ones)
            for name, value in self.values.items()
        }
        self._spread = values
        self._chassis = Chassis(values, DIMENSIONS)
        self._tyres = Tyres(values, self._chassis.static_load)
        self._drivetrain = Drivetrain(values, DIMENSIONS.wheel_radius)
        self._steering = Steering(values, DIMENSIONS.track_width, DIMENSIONS.wheelbase)

    def _latent_specs(self) -> dict[str, TensorSpec]:
        return {
            name: Unbounded(torch.Size((*self.batch_size, *shape)), device=self.device)
            for name, shape in LATENT_SHAPES.items()
        }

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        # A car seen in motion: wheels roll, the motor neither drives nor brakes, and steering,
        # tyres and springs are what a steady turn with this yaw rate would need.
        at_cg = shift_velocity(velocity, -DIMENSIONS.sensor_to_cg)
        vx, vy, yaw_rate = at_cg.unbind(-1)
        servo = self._guessed_servo(at_cg)
        cos, sin = self._steering.directions(servo)
        along, across = self._chassis.wheel_velocity(vx, vy, yaw_rate, cos, sin)
        transport = self._tyres.transport_speed(along, across, along)
        slip_speed = torch.stack([torch.zeros_like(across), -across])  # (2, 4, *)
        friction = self._tyres.friction(self._chassis.static_load, slip_speed)
        slip = slip_speed / transport
        slip = slip / self._tyres.strain(slip, friction).clamp_min(1.0)
        charge = (1.0 - self._spread["initial_charge"]) * self._spread["capacity"]
        charge = charge.expand_as(vx)
        voltage = self._drivetrain.open_voltage(charge)
        lean = torch.stack([torch.zeros_like(vx), vx * yaw_rate], -1)
        return {
            WHEEL_SLIP: torch.zeros_like(along).movedim(0, -1),
            TYRE_SLIP: slip.movedim((0, 1), (-2, -1)).contiguous(),
            LEAN: torch.stack([lean, torch.zeros_like(lean)], -2),
            SERVO: servo.unsqueeze(-1),
            DUTY: self._drivetrain.freewheeling_duty(vx, voltage).unsqueeze(-1),
            CHARGE: charge.unsqueeze(-1).clone(),
        }

    def _guessed_servo(self, velocity: Tensor) -> Tensor:
        # Front wheels point where their axle moves, plus the slip that carries their load.
        vx, _, yaw_rate = velocity.unbind(-1)
        needed = vx * yaw_rate / (GRAVITY * self._spread["front_cornering_stiffness"])
        angle = slip_angle(velocity, 0.0, self._spread["cg_to_front_axle"]) + needed
        weight = vx.square() / (vx.square() + GUESS_SPEED**2)
        return weight * self._steering.servo_at(angle)

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        pose = state[keys.POSE]
        throttle, steering = action.unbind(-1)
        car = self._unpacked(state)
        down = torch.stack(
            torch.broadcast_tensors(self._spread["floor_slope_x"], self._spread["floor_slope_y"]),
            -1,
        )
        slope_x, slope_y = rotate(down, -pose[..., 2]).unbind(-1)
        setting = Setting(
            steering=steering,
            duty=self._drivetrain.target_duty(throttle),
            voltage=self._drivetrain.open_voltage(car.charge),
            slope_x=slope_x,
            slope_y=slope_y,
        )
        for _ in range(self._substeps):
            self._substep(car, setting, self.dt / self._substeps)
        return self._packed(car, pose)

    def _substep(self, car: CarState, setting: Setting, dt: float) -> None:
        chassis, tyres, drivetrain = self._chassis, self._tyres, self._drivetrain
        servo = self._steering.moved(car.servo, setting.steering, dt)
        duty = drivetrain.slewed(car.duty, setting.duty, dt)

        cos, sin = self._steering.directions(0.5 * (car.servo + servo))
        along, across = chassis.wheel_velocity(car.vx, car.vy, car.yaw_rate, cos, sin)
        slip_speed = torch.stack([car.tread - along, -across])  # (2, 4, *)
        transport = tyres.transport_speed(along, across, car.tread)
        slip, felt = tyres.relaxed(car.slip, slip_speed, transport, dt)
        load = chassis.loads(car.lean, car.lean_rate)
        strain = tyres.strain(felt, tyres.friction(load, slip_speed))
        force = tyres.force(felt, load, strain)
        car.slip = slip / strain.clamp_min(1.0)  # a sliding contact strains its carcass no further

        axle_speed = 0.5 * (car.tread[2] + car.tread[3])
        mean_duty = 0.5 * (car.duty + duty)
        current = drivetrain.current(mean_duty, axle_speed, setting.voltage)
        car.charge = drivetrain.drained(car.charge, mean_duty, current, dt)
        car.tread = drivetrain.spun(car.tread, force[0], load, current, dt)

        ax, ay, yaw_acceleration = chassis.acceleration(force, cos, sin, car.vx, car.vy)
        car.lean, car.lean_rate = chassis.leaned(car.lean, car.lean_rate, torch.stack([ax, ay]), dt)
        car.servo, car.duty = servo, duty
        self._moved(car, setting, ax, ay, yaw_acceleration, dt)

    def _moved(
        self,
        car: CarState,
        setting: Setting,
        ax: Tensor,
        ay: Tensor,
        yaw_acceleration: Tensor,
        dt: float,
    ) -> None:
        cos, sin = torch.cos(car.dyaw), torch.sin(car.dyaw)
        ax = ax + cos * setting.slope_x + sin * setting.slope_y
        ay = ay + cos * setting.slope_y - sin * setting.slope_x
        yaw_rate = car.yaw_rate + dt * yaw_acceleration
        turn = 0.5 * dt * (car.yaw_rate + yaw_rate)
        # dvx/dt = ax + r vy, dvy/dt = ay - r vx; one after the other, which keeps the speed of
        # a turning frame from growing.
        vx = car.vx + dt * ax + turn * car.vy
        vy = car.vy + dt * ay - turn * vx
        mean_x, mean_y = 0.5 * dt * (car.vx + vx), 0.5 * dt * (car.vy + vy)
        car.dx = car.dx + cos * mean_x - sin * mean_y
        car.dy = car.dy + sin * mean_x + cos * mean_y
        car.dyaw = car.dyaw + turn
        car.vx, car.vy, car.yaw_rate = vx, vy, yaw_rate

    def _unpacked(self, state: TensorDictBase) -> CarState:
        at_cg = shift_velocity(state[keys.VELOCITY], -DIMENSIONS.sensor_to_cg)
        vx, vy, yaw_rate = (part.contiguous() for part in at_cg.unbind(-1))
        servo = state[SERVO].squeeze(-1)
        cos, sin = self._steering.directions(servo)
        along, _ = self._chassis.wheel_velocity(vx, vy, yaw_rate, cos, sin)
        lean = state[LEAN].movedim((-2, -1), (0, 1)).contiguous()  # (2, 2, *)
        zero = torch.zeros_like(vx)
        return CarState(
            vx=vx,
            vy=vy,
            yaw_rate=yaw_rate,
            dx=zero,
            dy=zero,
            dyaw=zero,
            tread=along + state[WHEEL_SLIP].movedim(-1, 0),
            slip=state[TYRE_SLIP].movedim((-2, -1), (0, 1)).contiguous(),
            lean=lean[0],
            lean_rate=lean[1],
            servo=servo,
            duty=state[DUTY].squeeze(-1),
            charge=state[CHARGE].squeeze(-1),
        )

    def _packed(self, car: CarState, pose: Tensor) -> dict[str, Tensor]:
        cos, sin = self._steering.directions(car.servo)
        along, _ = self._chassis.wheel_velocity(car.vx, car.vy, car.yaw_rate, cos, sin)
        at_cg = torch.stack([car.vx, car.vy, car.yaw_rate], -1)
        # The sensor rides ahead of the centre of gravity: it moves by the same way plus its turn.
        ahead = DIMENSIONS.sensor_to_cg
        way = torch.stack(
            [car.dx + ahead * (torch.cos(car.dyaw) - 1.0), car.dy + ahead * torch.sin(car.dyaw)], -1
        )
        yaw = pose[..., 2]
        position = pose[..., :2] + rotate(way, yaw)
        lean = torch.stack([car.lean, car.lean_rate])  # (2, 2, *)
        return {
            keys.POSE: torch.cat([position, (yaw + car.dyaw).unsqueeze(-1)], -1),
            keys.VELOCITY: shift_velocity(at_cg, ahead),
            WHEEL_SLIP: (car.tread - along).movedim(0, -1).contiguous(),
            TYRE_SLIP: car.slip.movedim((0, 1), (-2, -1)).contiguous(),
            LEAN: lean.movedim((0, 1), (-2, -1)).contiguous(),
            SERVO: car.servo.unsqueeze(-1),
            DUTY: car.duty.unsqueeze(-1),
            CHARGE: car.charge.unsqueeze(-1),
        }

    def _rebuilt(self, batch_size: Sequence[int]) -> Self:
        values = {name: parameter.value for name, parameter in self.parameters.items()}
        return type(self)(batch_size, self.device, values, self.dt, self.substep)
