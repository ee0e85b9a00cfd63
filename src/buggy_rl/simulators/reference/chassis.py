"""The rigid body on four wheels: loads, suspension, accelerations."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY, Similarity, VehicleDimensions
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.tyres import per_wheel, sides

# The payload, of a buggy:
PAYLOAD_RADIUS = 0.04  # [m] radius of gyration: a block of 0.1 m; chosen
PAYLOAD_HEIGHT = 0.08  # [m] height of its centre above the floor: on the roof plate; chosen
TINY = 1e-12  # [m^2/s^2] under a root, for a gradient at rest


class Chassis:
    """Mass, geometry and suspension.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        dimensions: Wheelbase, track width and wheel radius.
        faults: The payload, over the centre of gravity.
        similarity: Ratios of the car to the buggy, which all its parts are made by.
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        dimensions: VehicleDimensions,
        faults: Faults | None = None,
        similarity: Similarity | None = None,
    ) -> None:
        faults = faults or Faults({}, values["mass"])
        self.similarity = similarity or Similarity()
        radius, height = (self.similarity.length * m for m in (PAYLOAD_RADIUS, PAYLOAD_HEIGHT))
        ratio = faults["payload.mass_ratio"]
        payload = values["mass"] * (ratio - 1.0)
        self.mass = values["mass"] * ratio
        self.yaw_inertia = values["yaw_inertia"] + payload * radius**2
        self.drag = values["aerodynamic_drag"]
        to_front = values["cg_to_front_axle"]
        to_rear = dimensions.wheelbase - to_front
        self.wheel_x = per_wheel(to_front, -to_rear)
        half_track = 0.5 * dimensions.track_width
        side = sides(to_front)
        self.wheel_y = torch.cat([side, side]) * half_track * torch.ones_like(to_front)

        weight = 0.5 * self.mass * GRAVITY
        self.static_load = per_wheel(
            weight * to_rear / dimensions.wheelbase, weight * to_front / dimensions.wheelbase
        )
        self.front_mass = 2.0 * self.static_load[0] / GRAVITY
        higher = (height - values["cg_height"]) * ((ratio - 1.0) / ratio)
        moment = self.mass * (values["cg_height"] + higher)  # [kg m] moment over acceleration
        pitch = 0.5 * moment / dimensions.wheelbase
        roll = moment / dimensions.track_width
        share = values["front_roll_share"]
        # Load change over balanced acceleration: forward unloads the front, leftward the left.
        self.pitch_transfer = per_wheel(-pitch, pitch)
        self.roll_transfer = -torch.sign(self.wheel_y) * per_wheel(
            roll * share, roll * (1.0 - share)
        )
        frequency = torch.stack(
            torch.broadcast_tensors(values["pitch_frequency"], values["roll_frequency"])
        )
        self.stiffness = (2.0 * math.pi * frequency).square()  # (2, *) [1/s^2]
        self.damping = 4.0 * math.pi * frequency * values["suspension_damping"]  # (2, *) [1/s]

    def loads(self, lean: Tensor, lean_rate: Tensor) -> Tensor:
        """Normal load [4, *] [N] of each wheel, not below 0.

        F_z = F_z0 + T (x + x' 2 zeta / omega): spring and damper both press on the wheel.

        Args:
            lean: [2, *] pitch and roll, as the acceleration they balance [m/s^2].
            lean_rate: [2, *] its rate [m/s^3].
        """
        along, across = lean + lean_rate * (self.damping / self.stiffness)
        load = self.static_load + self.pitch_transfer * along + self.roll_transfer * across
        return load.clamp_min(0.0)

    def leaned(
        self, lean: Tensor, lean_rate: Tensor, acceleration: Tensor, dt: float
    ) -> tuple[Tensor, Tensor]:
        """Pitch and roll after a step: x'' = omega^2 (a - x) - 2 zeta omega x'.

        All [2, *], forward and leftward; `acceleration` is what the tyres give [m/s^2].
        """
        rate = lean_rate + dt * (self.stiffness * (acceleration - lean) - self.damping * lean_rate)
        return lean + dt * rate, rate

    def wheel_velocity(
        self, vx: Tensor, vy: Tensor, yaw_rate: Tensor, cos: Tensor, sin: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Velocity of each wheel's ground point along and across the wheel, each [4, *] [m/s].

        Args:
            vx: [*] at the centre of gravity [m/s].
            vy: [*] likewise.
            yaw_rate: [*] [rad/s].
            cos: [4, *] of the wheels' steering angles.
            sin: [4, *] likewise.
        """
        wheel_vx = vx - yaw_rate * self.wheel_y
        wheel_vy = vy + yaw_rate * self.wheel_x
        return cos * wheel_vx + sin * wheel_vy, cos * wheel_vy - sin * wheel_vx

    def acceleration(
        self, force: Tensor, cos: Tensor, sin: Tensor, vx: Tensor, vy: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Forward, leftward [m/s^2] and yaw acceleration [rad/s^2], each [*], of tyres and air.

        Args:
            force: [2, 4, *] of the ground on the tyres, along and across [N].
            cos: [4, *] of the wheels' steering angles.
            sin: [4, *] likewise.
            vx: [*] at the centre of gravity [m/s].
            vy: [*] likewise.
        """
        along, across = force
        force_x = cos * along - sin * across  # (4, *) body frame
        force_y = sin * along + cos * across
        moment = (self.wheel_x * force_y - self.wheel_y * force_x).sum(0)
        air = self.drag * (vx.square() + vy.square() + TINY).sqrt()
        ax = (force_x.sum(0) - air * vx) / self.mass
        ay = (force_y.sum(0) - air * vy) / self.mass
        return ax, ay, moment / self.yaw_inertia
