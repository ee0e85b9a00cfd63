"""Drivetrains of the reference car with brakes and reverse, with a speed or a current controller.

The duty cycle of the one-way car is here what the controller is asked for, d in -1..1 (0..1 without
reverse), behind its dead zones and its slew.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import command_of, drive_of
from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.simulators.reference.chassis import Chassis
from buggy_rl.simulators.reference.drivetrain import Drivetrain
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.parameters import Build
from buggy_rl.simulators.reference.state import CONTROLLER, SPEED_SUM, CarState, Setting
from buggy_rl.simulators.reference.steering import SecondOrderLag

STANDS = 0.1  # [m/s] forward speed below which that of a buggy reverses; chosen
IDLE = 1e-3  # [-] duty cycle asked for below which the drag brake is on; chosen


class TwoWayDrivetrain(Drivetrain):
    """A speed controller with brakes on both axles and reverse, or one without a duty cycle.

    Args:
        build: Of the car; that of one with a one-way throttle is a `Drivetrain`.
        values, chassis, faults, dt: As for `Drivetrain`.
    """

    def __init__(
        self,
        build: Build,
        values: Mapping[str, Tensor],
        chassis: Chassis,
        faults: Faults | None = None,
        dt: float = 1e-3,
    ) -> None:
        super().__init__(values, build.dimensions.wheel_radius, chassis, faults, dt)
        self.dt = dt
        self.command, faults = build.command, self.faults
        self.stands = build.similarity.speed * STANDS
        if self.command.kind != "throttle_brake_reverse":  # they have no dead zone of their own
            self.deadband = faults["throttle_deadband.width"]
        self.behind = torch.zeros_like(self.deadband)
        if self.command.kind == "throttle_brake_reverse":
            self._size_brakes(values)
        self.late = SecondOrderLag(faults["speed_controller_lag.time_constant"], dt)
        # The rear tyres slip by a / (C g share) at an acceleration a: the sensor's share of that.
        rear = values["cg_to_front_axle"] / build.dimensions.wheelbase
        stiffness = values["longitudinal_stiffness"] * GRAVITY * rear
        if self.command.kind == "speed":
            ramp = faults["speed_ramp.acceleration"] / values["full_speed"]  # [1/s]
            self.slew = torch.minimum(self.slew, ramp)
        self.at_axle = faults["driven_axle_slip.slip_per_acceleration"] * stiffness

    def _size_brakes(self, values: Mapping[str, Tensor]) -> None:
        faults, spare = self.faults, values["reverse_deadband"]
        self.behind = spare + (1.0 - spare) * faults["reverse_deadband.width"]
        self.brake = values["brake_force"] * faults["brake_gain.gain"]
        share = values["brake_front_share"] + faults["brake_balance.shift"]
        self.in_front = share.clamp(0.0, 1.0)
        braked = faults["drag_brake.deceleration"] * self.rolling_mass
        self.dragged = values["drag_brake"] + braked

    def target_duty(self, throttle: Tensor) -> Tensor:
        drive = drive_of(throttle, self.command.rest)
        forward = ((drive - self.deadband) / (1.0 - self.deadband)).clamp_min(0.0)
        if "throttle_gain" in self.faults:
            forward = forward * self.faults["throttle_gain.gain"]
        if not self.command.two_way:
            return forward
        backward = (-drive - self.behind) / (1.0 - self.behind)
        return forward - backward.clamp(0.0, 1.0)

    def throttle_at(self, duty: Tensor) -> Tensor:
        gain = self.faults["throttle_gain.gain"]
        forward = self.deadband + (1.0 - self.deadband) * duty / gain
        backward = self.behind - (1.0 - self.behind) * duty
        drive = torch.where(duty > 0, forward.clamp_max(1.0), -backward.clamp_max(1.0))
        return command_of(torch.where(duty == 0, 0.0, drive), self.command.rest)

    def freewheeling_duty(self, speed: Tensor, voltage: Tensor) -> Tensor:
        if self.command.kind == "speed":
            held = speed / self.values["full_speed"]
        elif self.command.kind == "current":
            held = torch.zeros_like(speed)
        else:
            held = self.motor_constant * speed / voltage
            held = torch.where(speed < 0, held / self.values["reverse_share"].clamp_min(0.1), held)
        return held.clamp(-1.0 if self.command.two_way else 0.0, 1.0)

    def motor(
        self, asked: Tensor, car: CarState, setting: Setting, heat: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        if self.command.kind == "throttle_brake_reverse":
            reverse = torch.where(car.vx > self.stands, 0.0, self.values["reverse_share"])
            return super().motor(torch.where(asked < 0, reverse * asked, asked), car, setting, heat)
        axle = 0.5 * (car.tread[2] + car.tread[3])
        wanted = self._wanted(self._summed(asked, car, axle), car, axle)
        current = self._reachable(wanted, axle, setting.voltage)
        if "speed_controller_lag" in self.faults:
            state = car.fault_state
            state[CONTROLLER] = self.late.moved(state[CONTROLLER], current)
            current = state[CONTROLLER][1]
        used = self.motor_resistance * current + self.motor_constant * axle
        return used / setting.voltage, current

    def brakes(self, duty: Tensor, target: Tensor, car: CarState) -> tuple[Tensor, Tensor] | None:
        if self.command.kind != "throttle_brake_reverse":
            return None
        pressed = torch.where(car.vx > self.stands, (-duty).clamp_min(0.0), 0.0) * self.brake
        drag = torch.where(target.abs() < IDLE, self.dragged, torch.zeros_like(self.dragged))
        return self.in_front * pressed, (1.0 - self.in_front) * pressed + drag

    def current(
        self, duty: Tensor, axle_speed: Tensor, voltage: Tensor, heat: Tensor | None = None
    ) -> Tensor:
        winding = self.motor_resistance
        if heat is not None:
            winding = winding * (1.0 + self.faults["heating_motor.rise"] * heat)
        resistance = winding + duty.square() * self.battery_resistance
        current = (duty * voltage - self.motor_constant * axle_speed) / resistance
        if "motor_power_limit" in self.faults:
            reached = (self.motor_constant * axle_speed.abs()).clamp_min(self.crawl)
            current = torch.clamp(current, -self.power / reached, self.power / reached)
        # It freewheels: a current flows only in the direction of the duty cycle.
        forward = torch.where(duty > 0, current.clamp_min(0.0), 0.0)
        return torch.where(duty < 0, current.clamp_max(0.0), forward)

    def _wanted(self, asked: Tensor, car: CarState, axle: Tensor) -> Tensor:
        """Current [*] [A] that a speed or current controller wants.

        i = K (v_set - v) / k, with v the car's speed, or in part the driven axle's; no more than
        its limits along and against the motion.
        """
        if self.command.kind == "current":
            return asked * self.values["full_current"]
        seen = car.vx + self.at_axle * (axle - car.vx)
        missing = self.values["full_speed"] * asked - seen
        wanted = self.values["speed_gain"] * missing / self.motor_constant
        pull = self.values["pull_force"] / self.motor_constant
        brake = self.values["brake_force"] / self.motor_constant
        most = torch.where(seen < 0, brake, pull)
        least = torch.where(seen > 0, -brake, -pull)
        wanted = torch.clamp(wanted, least, most)
        if "least_speed" in self.faults:  # it lets go
            lets_go = (self.values["full_speed"] * asked).abs() < self.faults["least_speed.speed"]
            wanted = torch.where(lets_go, torch.zeros_like(wanted), wanted)
        return wanted

    def _summed(self, asked: Tensor, car: CarState, axle: Tensor) -> Tensor:
        """Setpoint [*], of a full one, with what the integral of the error adds.

        dI/dt = rate (v_set - v), |I| at most what pulls with all its force.
        """
        if "speed_integral" not in self.faults:
            return asked
        full = self.values["full_speed"]
        total = car.fault_state[SPEED_SUM].squeeze(0)
        seen = car.vx + self.at_axle * (axle - car.vx)
        gained = self.faults["speed_integral.rate"] * (full * asked - seen) * self.dt
        most = self.values["pull_force"] / self.values["speed_gain"]
        total = torch.clamp(total + gained, -most, most)
        car.fault_state[SPEED_SUM] = total.unsqueeze(0)
        return asked + total / full

    def _reachable(self, current: Tensor, axle: Tensor, voltage: Tensor) -> Tensor:
        """A current [*] [A] within what the battery drives against the back-EMF, either way."""
        resistance = self.motor_resistance + self.battery_resistance
        back = self.motor_constant * axle
        return torch.clamp(current, (-voltage - back) / resistance, (voltage - back) / resistance)
