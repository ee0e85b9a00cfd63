"""Floor, air, and a supply that gives way: slope, wind, patches, damping, heat."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import LongitudinalCommand, drive_of
from buggy_rl.core.vehicle import rotate
from buggy_rl.simulators.reference.chassis import Chassis
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.state import SUPPLY_HEAT, CarState

BODY_EFFECTS = ("floor_slope", "wind", "aerodynamic_drag", "yaw_damping")
SIDE_AREA = 1.8  # [-] side over frontal area: 0.273 m of length over 0.15 m of width
# Of a buggy's tyre, over which its friction changes at the edge of a patch; chosen.
CONTACT_LENGTH = 0.02  # [m]
TINY = 1e-12  # [m^2/s^2] under a root, for a gradient at rest


class Surroundings:
    """Slope, air and floor; neutral without a fault.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        chassis: The car's body.
        rolling_mass: Of car and turning wheels together [kg].
        sensor_to_cg: [m] by which the pose's point is ahead of the centre of gravity.
        faults: Of floor and air.
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        chassis: Chassis,
        rolling_mass: Tensor,
        sensor_to_cg: float,
        faults: Faults,
    ) -> None:
        self.faults, self.chassis, self.sensor_to_cg = faults, chassis, sensor_to_cg
        self.pushes = any(effect in faults for effect in BODY_EFFECTS)
        self.patchy = "grip_patch" in faults
        self.contact_length = chassis.similarity.length * CONTACT_LENGTH
        self.slope = _pair(faults, "floor_slope.along_x", "floor_slope.along_y")  # (*, 2)
        self.middle = _pair(faults, "grip_patch.x", "grip_patch.y")
        share = rolling_mass / chassis.mass
        self.drag = faults["aerodynamic_drag.coefficient"] * share
        self.front = values["aerodynamic_drag"] / chassis.mass  # [1/m]
        self.wind = self._wind_speed(share)

    def _wind_speed(self, share: Tensor) -> Tensor:
        """World velocity [*, 2] of the wind, from its force over mass at rest.

        m f = c W^2, with c the mean of front and side.
        """
        force = _pair(self.faults, "wind.force_x", "wind.force_y") * share.unsqueeze(-1)
        size = torch.linalg.vector_norm(force, dim=-1, keepdim=True)
        drag = (0.5 * (1.0 + SIDE_AREA) * self.front).unsqueeze(-1)
        return force / (size * drag + TINY).sqrt()

    def push(self, car: CarState, pose: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Forward, leftward [m/s^2] and yaw acceleration [rad/s^2], each [*].

        Args:
            car: Its motion.
            pose: [*, 3] at the start of the control period.
        """
        faults, vx, vy = self.faults, car.vx, car.vy
        yaw = pose[..., 2] + car.dyaw
        ax, ay = rotate(self.slope.expand(*yaw.shape, 2), -yaw).unbind(-1)
        if "aerodynamic_drag" in faults:
            drag = self.drag * (vx.square() + vy.square() + TINY).sqrt()
            ax, ay = ax - drag * vx, ay - drag * vy
        if "wind" in faults:
            wind_x, wind_y = rotate(self.wind.expand(*yaw.shape, 2), -yaw).unbind(-1)
            blown, still = self._air(wind_x - vx, wind_y - vy), self._air(-vx, -vy)
            ax, ay = ax + (blown[0] - still[0]), ay + (blown[1] - still[1])
        return ax, ay, -faults["yaw_damping.rate"] * car.yaw_rate

    def _air(self, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
        """Acceleration by an air stream over the body.

        F = c |w| (w_x, k w_y).
        """
        stream = self.front * (along.square() + across.square() + TINY).sqrt()
        return stream * along, SIDE_AREA * stream * across

    def grip(self, car: CarState, pose: Tensor) -> Tensor:
        """Friction [4, *] where each wheel stands, over that of the floor."""
        cos, sin = torch.cos(car.dyaw), torch.sin(car.dyaw)
        x, y = self.chassis.wheel_x, self.chassis.wheel_y
        # From the sensor at the start of the period, in the body frame of that moment.
        wheel = torch.stack(
            [car.dx - self.sensor_to_cg + cos * x - sin * y, car.dy + sin * x + cos * y], -1
        )  # (4, *, 2)
        place = pose[..., :2] + rotate(wheel, pose[..., 2].expand(wheel.shape[:-1]))
        distance = torch.linalg.vector_norm(place - self.middle, dim=-1)
        inside = (self.faults["grip_patch.radius"] - distance) / self.contact_length + 0.5
        return 1.0 - (1.0 - self.faults["grip_patch.grip"]) * inside.clamp(0.0, 1.0)


def _pair(faults: Faults, x: str, y: str) -> Tensor:
    return torch.stack(torch.broadcast_tensors(faults[x], faults[y]), -1)


SERVO_SPEED = 5.0  # [1/s] of a servo that draws its largest current: under half of its fastest


class Supply:
    """What is left of the duty cycle; all of it without a fault.

    Args:
        faults: Of servo supply and controller.
        command: What the first command is.
        dt: Substep [s].
    """

    def __init__(self, faults: Faults, command: LongitudinalCommand, dt: float) -> None:
        self.faults, self.rest, self.dt = faults, command.rest, dt
        self.weak = "brown_out" in faults or "thermal_foldback" in faults

    def left(
        self,
        fault_state: dict[str, Tensor],
        duty: Tensor,
        throttle: Tensor,
        before: Tensor,
        servo: Tensor,
    ) -> Tensor:
        """Duty cycle [*] at the motor, of the one that the controller makes [*].

        Args:
            fault_state: Holds the heat, which is moved on.
            duty: [*], of either sign; a brake is not weakened.
            throttle: [*] command, whose square heats.
            before: [*] position of the servo before the step.
            servo: [*] after it.
        """
        left = torch.ones_like(duty)
        if "brown_out" in self.faults:
            fast = ((servo - before).abs() / (self.dt * SERVO_SPEED)).clamp_max(1.0)
            drawn = self.faults["brown_out.moving"] * fast
            left = left - drawn - self.faults["brown_out.holding"] * servo.abs()
        if "thermal_foldback" in self.faults:
            heat = fault_state[SUPPLY_HEAT].squeeze(0)
            left = left * (1.0 - self.faults["thermal_foldback.foldback"] * heat)
            work = drive_of(throttle, self.rest).clamp(-1.0, 1.0).square()
            rate = self.dt / self.faults["thermal_foldback.time_constant"]
            fault_state[SUPPLY_HEAT] = (heat + rate * (work - heat)).unsqueeze(0)
        return torch.where(duty > 0, duty * left.clamp_min(0.0), duty)
