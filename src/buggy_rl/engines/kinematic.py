"""The kinematic bicycle: no slip angles. The baseline without tyres."""

import torch
from torch import Tensor

from buggy_rl.engines.actuation import ActuatedEngine
from buggy_rl.engines.longitudinal_force import resistance


class KinematicEngine(ActuatedEngine):
    """A bicycle without slip, behind the same motor and actuators as `SingleTrackEngine`.

    m dvx = motor - resistance,  r = vx tan(delta) / L,  vy = l_r r,

    so its sideslip angle is atan(l_r / L tan(delta)). Sideways motion follows from the steering
    alone: of an edited velocity only vx is remembered.

    Integrated by the explicit midpoint rule.
    """

    def _substep(self, velocity: Tensor, drive: Tensor, steering_angle: Tensor, h: float) -> Tensor:
        v = self.values
        vx = velocity[..., 0]
        halfway = vx + 0.5 * h * self._acceleration(vx, drive, steering_angle)
        vx = vx + h * self._acceleration(halfway, drive, steering_angle)
        wheelbase = v["cg_to_front_axle"] + v["cg_to_rear_axle"]
        yaw_rate = vx * torch.tan(steering_angle) / wheelbase
        return torch.stack([vx, v["cg_to_rear_axle"] * yaw_rate, yaw_rate], -1)

    def _acceleration(self, vx: Tensor, drive: Tensor, steering_angle: Tensor) -> Tensor:
        force = self.law.drive(vx, drive, self.values)
        if self.law.brake is not None:
            force = force + self.law.brake(vx, drive, self.values)
        force = force - resistance(vx, steering_angle, self.values)
        return force / self.values["mass"]
