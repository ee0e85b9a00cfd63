"""The dynamic bicycle: two axles with magic-formula tyres, a DC motor, delayed actuators."""

import math

import torch
from torch import Tensor

from buggy_rl.engines.actuation import ActuatedEngine, motor_force, resistance
from buggy_rl.vehicle import GRAVITY

SLIP_SPEED = 0.3  # [m/s] rolling speed below which slip angles are softened; chosen
GAMMA = 1 - 1 / math.sqrt(2)  # of the Rosenbrock method ROS2, L-stable with it; Verwer et al. 1999

TYRES = (
    ("yaw_inertia", 0.0005, 0.1, "kg m^2", "Inertia about the vertical axis through the cg."),
    ("front_drive_share", 0.0, 1.0, "-", "Share of the wheel force at the front axle."),
    ("front_grip", 0.05, 3.0, "-", "D, largest lateral force of the front axle over its load."),
    ("front_shape", 0.3, 2.5, "-", "C, shape factor of the front axle's magic formula."),
    (
        "front_stiffness",
        0.5,
        60.0,
        "1/rad",
        "B, stiffness factor of the front axle's magic formula.",
    ),
    ("rear_grip", 0.05, 3.0, "-", "D, largest lateral force of the rear axle over its load."),
    ("rear_shape", 0.3, 2.5, "-", "C, shape factor of the rear axle's magic formula."),
    ("rear_stiffness", 0.5, 60.0, "1/rad", "B, stiffness factor of the rear axle's magic formula."),
)


def rolling_speed(along: Tensor) -> Tensor:
    """Speed a slip angle is taken against: |v|, but smoothly no less than half of `SLIP_SPEED`.

    Above `SLIP_SPEED` v0 it is exact; below, (v^2 + v0^2) / (2 v0), of the same value and slope at
    v0. So at rest the lateral force is a linear damping of the lateral slip speed: no force without
    motion, and at a crawl the car rolls in the direction of its wheels.

    Args:
        along: [*] velocity along the wheel [m/s].
    """
    slow = (along.square() + SLIP_SPEED**2) / (2 * SLIP_SPEED)
    return torch.where(along.abs() < SLIP_SPEED, slow, along.abs())


class SingleTrackEngine(ActuatedEngine):
    """A dynamic bicycle with static axle loads and no combined slip.

    m (dvx - vy r) = Xf cos(delta) - Yf sin(delta) + Xr
    m (dvy + vx r) = Xf sin(delta) + Yf cos(delta) + Yr
    I dr = lf (Xf sin(delta) + Yf cos(delta)) - lr Yr

    with Y = -m_axle g D sin(C atan(B alpha)) per axle, alpha the slip angle (`vehicle.slip_angle`)
    and X the motor's force less the resistance, shared between the axles.

    Each substep is one step of the two-stage Rosenbrock W-method ROS2, second order and L-stable.
    Its matrix holds the tyres' damping of the lateral slip speed, the only stiff term at low speed,
    at its value at zero slip angle: an upper bound, which keeps the method stable.

    Source: of the force laws and the presets, DART, Lyons et al., dart_dynamic_models.py.
    """

    own_parameters = TYRES

    def _substep(self, velocity: Tensor, drive: Tensor, steering_angle: Tensor, h: float) -> Tensor:
        cos, sin = torch.cos(steering_angle), torch.sin(steering_angle)
        steered = (steering_angle, cos, sin)
        rate, damping = self._rates(velocity, drive, steered)
        first = self._damped(rate, damping, cos, sin, GAMMA * h)  # (*, 3)
        rate, _ = self._rates(velocity + h * first, drive, steered)
        second = self._damped(rate - 2 * first, damping, cos, sin, GAMMA * h)
        return velocity + h * (1.5 * first + 0.5 * second)

    def _rates(
        self, velocity: Tensor, drive: Tensor, steered: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Rate of change [*, 3] of the velocity, and the tyres' slip damping [*, 2] N s/m."""
        v = self.values
        angle, cos, sin = steered
        vx, vy, yaw_rate = velocity.unbind(-1)
        at_front = vy + v["cg_to_front_axle"] * yaw_rate
        at_rear = vy - v["cg_to_rear_axle"] * yaw_rate
        along = rolling_speed(torch.stack([cos * vx + sin * at_front, vx], -1))  # (*, 2)
        across = torch.stack([cos * at_front - sin * vx, at_rear], -1)  # (*, 2)

        alpha = torch.atan(across / along)
        front, rear = (-self._peak * torch.sin(self._C * torch.atan(self._B * alpha))).unbind(-1)
        damping = self._peak * self._C * self._B / along

        force = motor_force(vx, drive, v) - resistance(vx, angle, v)
        front_force = v["front_drive_share"] * force
        lateral = front_force * sin + front * cos
        ax = (front_force * cos + force - front_force - front * sin) / v["mass"] + vy * yaw_rate
        ay = (lateral + rear) / v["mass"] - vx * yaw_rate
        yaw = (v["cg_to_front_axle"] * lateral - v["cg_to_rear_axle"] * rear) / v["yaw_inertia"]
        return torch.stack([ax, ay, yaw], -1), damping

    def _damped(
        self, rate: Tensor, damping: Tensor, cos: Tensor, sin: Tensor, step: float
    ) -> Tensor:
        """Solves (1 + step M^-1 N K N^T) k = rate, with K = diag(damping) [*, 2].

        The columns of N turn velocity into the lateral slip of an axle, (-sin, cos, lf cos) and
        (0, 1, -lr), so two unknowns remain (Woodbury identity).
        """
        mass, inertia = self.values["mass"], self.values["yaw_inertia"]
        lf, lr = self.values["cg_to_front_axle"], self.values["cg_to_rear_axle"]
        x, y, yaw = rate.unbind(-1)
        front, rear = (step * damping).unbind(-1)
        # S = N^T M^-1 N, the slip that a unit of lateral force makes
        ff = 1 / mass + (lf * cos).square() / inertia
        fr = cos * (1 / mass - lf * lr / inertia)
        rr = 1 / mass + lr.square() / inertia
        slip_front = cos * (y + lf * yaw) - sin * x
        slip_rear = y - lr * yaw
        determinant = (1 + front * ff) * (1 + rear * rr) - front * rear * fr.square()
        force_front = front * ((1 + rear * rr) * slip_front - rear * fr * slip_rear) / determinant
        force_rear = rear * ((1 + front * ff) * slip_rear - front * fr * slip_front) / determinant
        x = x + sin * force_front / mass
        y = y - (cos * force_front + force_rear) / mass
        yaw = yaw - (lf * cos * force_front - lr * force_rear) / inertia
        return torch.stack([x, y, yaw], -1)

    def _parameters_changed(self) -> None:
        super()._parameters_changed()
        v = self.values
        self._B, self._C, grip = (
            self._pair("front", "rear", factor) for factor in ("stiffness", "shape", "grip")
        )
        wheelbase = v["cg_to_front_axle"] + v["cg_to_rear_axle"]
        arms = torch.stack(torch.broadcast_tensors(v["cg_to_rear_axle"], v["cg_to_front_axle"]), -1)
        load = (v["mass"] * GRAVITY / wheelbase).unsqueeze(-1) * arms  # (*, 2) front, rear
        self._peak = load * grip
