"""The dynamic bicycle, two axles with magic-formula tyres, and the kinematic one without slip."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from buggy_rl.core.kernels import Kernel
from buggy_rl.core.parameters import Realisations, Scaled
from buggy_rl.core.vehicle import GRAVITY, side_by_side_columns
from buggy_rl.simulators.bicycle.actuation import ActuatedEngine, moved_on
from buggy_rl.simulators.bicycle.longitudinal import ONE_WAY_LAW, LongitudinalLaw, resistance
from buggy_rl.simulators.bicycle.parameters import ACTUATION, TYRES, declare

SLIP_SPEED = 0.3  # [m/s] rolling speed below which slip angles are softened; chosen
GAMMA = 1 - 1 / math.sqrt(2)  # of the Rosenbrock method ROS2, L-stable with it; Verwer et al. 1999


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


class Axle(NamedTuple):
    """Magic formula of an axle: F = -peak sin(C atan(B alpha)); each of shape () or [*]."""

    stiffness: Tensor
    """B [1/rad]."""
    shape: Tensor
    """C."""
    peak: Tensor
    """[N]"""

    @classmethod
    def of(cls, values: Mapping[str, Tensor], name: str, load: Tensor) -> "Axle":
        """`front` or `rear`, which carries `load` [N]."""
        stiffness, shape, grip = (values[f"{name}_{f}"] for f in ("stiffness", "shape", "grip"))
        return cls(stiffness, shape, load * grip)

    def force(self, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
        """Lateral force [N], and how it damps slip at none [N s/m], at a velocity [*] [m/s]."""
        rolling = rolling_speed(along)
        alpha = torch.atan(across / rolling)
        force = -self.peak * torch.sin(self.shape * torch.atan(self.stiffness * alpha))
        return force, self.peak * self.shape * self.stiffness / rolling


class SingleTrack:
    """The physics of `SingleTrackEngine`.

    Args:
        values: Parameter name -> value, each of shape () or [*].
        law: Of motor and brakes.
    """

    def __init__(self, values: Mapping[str, Tensor], law: LongitudinalLaw = ONE_WAY_LAW) -> None:
        self.values = v = values
        self._law = law
        load = v["mass"] * GRAVITY / (v["cg_to_front_axle"] + v["cg_to_rear_axle"])  # [N/m]
        self._front = Axle.of(v, "front", load * v["cg_to_rear_axle"])
        self._rear = Axle.of(v, "rear", load * v["cg_to_front_axle"])

    def substep(self, velocity: Tensor, drive: Tensor, steering_angle: Tensor, h: Any) -> Tensor:
        """Velocity [*, 3] of the centre of gravity `h` seconds later, with constant actuators."""
        start = velocity.unbind(-1)
        cos, sin = torch.cos(steering_angle), torch.sin(steering_angle)
        steered = (steering_angle, cos, sin)
        rate, damping = self._rates(start, drive, steered)
        first = self._damped(rate, damping, cos, sin, GAMMA * h)
        middle = tuple(v + h * k for v, k in zip(start, first, strict=True))
        rate, _ = self._rates(middle, drive, steered)
        rest = tuple(r - 2 * k for r, k in zip(rate, first, strict=True))
        second = self._damped(rest, damping, cos, sin, GAMMA * h)
        stages = zip(start, first, second, strict=True)
        return side_by_side_columns(*(v + h * (1.5 * k + 0.5 * m) for v, k, m in stages))

    def _rates(
        self, velocity: Sequence[Tensor], drive: Tensor, steered: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[tuple[Tensor, ...], tuple[Tensor, Tensor]]:
        """Rate of change of vx, vy and yaw rate; slip damping of both axles' tyres [N s/m]."""
        v = self.values
        angle, cos, sin = steered
        vx, vy, yaw_rate = velocity
        at_front = vy + v["cg_to_front_axle"] * yaw_rate
        at_rear = vy - v["cg_to_rear_axle"] * yaw_rate
        along = cos * vx + sin * at_front
        front, front_damping = self._front.force(along, cos * at_front - sin * vx)
        rear, rear_damping = self._rear.force(vx, at_rear)

        force = self._law.drive(vx, drive, v) - resistance(vx, angle, v)
        front_force = v["front_drive_share"] * force
        if self._law.brake is not None:
            braking = self._law.brake(vx, drive, v)
            front_force = front_force + v["brake_front_share"] * braking
            force = force + braking
        lateral = front_force * sin + front * cos
        ax = (front_force * cos + force - front_force - front * sin) / v["mass"] + vy * yaw_rate
        ay = (lateral + rear) / v["mass"] - vx * yaw_rate
        yaw = (v["cg_to_front_axle"] * lateral - v["cg_to_rear_axle"] * rear) / v["yaw_inertia"]
        return (ax, ay, yaw), (front_damping, rear_damping)

    def _damped(
        self,
        rate: Sequence[Tensor],
        damping: tuple[Tensor, Tensor],
        cos: Tensor,
        sin: Tensor,
        step: float,
    ) -> tuple[Tensor, ...]:
        """Solves (1 + step M^-1 N K N^T) k = rate, with K = diag(damping).

        The columns of N turn velocity into the lateral slip of an axle, (-sin, cos, lf cos) and
        (0, 1, -lr), so two unknowns remain (Woodbury identity).
        """
        mass, inertia = self.values["mass"], self.values["yaw_inertia"]
        lf, lr = self.values["cg_to_front_axle"], self.values["cg_to_rear_axle"]
        x, y, yaw = rate
        front, rear = (step * d for d in damping)
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
        return x, y, yaw


class SingleTrackEngine(ActuatedEngine):
    """A dynamic bicycle with static axle loads and no combined slip.

    m (dvx - vy r) = Xf cos(delta) - Yf sin(delta) + Xr
    m (dvy + vx r) = Xf sin(delta) + Yf cos(delta) + Yr
    I dr = lf (Xf sin(delta) + Yf cos(delta)) - lr Yr

    with Y = -m_axle g D sin(C atan(B alpha)) per axle, alpha the slip angle (`vehicle.slip_angle`)
    and X the motor's force less the resistance, shared between the axles, and that of brakes, which
    has a share of its own. The slip angle is taken against |vx|, so the law holds in reverse.

    Each substep is one step of the two-stage Rosenbrock W-method ROS2, second order and L-stable.
    Its matrix holds the tyres' damping of the lateral slip speed, the only stiff term at low speed,
    at its value at zero slip angle: an upper bound, which keeps the method stable.

    Source: of the force laws and the presets, DART, Lyons et al., dart_dynamic_models.py.
    """

    own_parameters = TYRES

    @property
    def realises(self) -> Realisations:
        own: dict[str, Any] = {}
        if self.command.kind in ("throttle", "throttle_brake_reverse"):
            gear = (Scaled("drive_force", "ratio"), Scaled("drive_force_loss", "ratio", 2.0))
            own["gear_ratio"] = gear
        return {
            **super().realises,
            **own,
            "tire_grip": _friction("grip", 1.0, 1.0),
            "grip_balance": _friction("front_to_rear", 0.5, -0.5),
        }

    def _substep(self, velocity: Tensor, drive: Tensor, steering_angle: Tensor, h: float) -> Tensor:
        return self._physics.substep(velocity, drive, steering_angle, h)

    def _moved_on(
        self, actuators: Sequence[Tensor], pose: Tensor, velocity: Tensor
    ) -> tuple[Tensor, Tensor]:
        substep = KERNEL.compiled(pose[..., 0]) if self.command.kind == "throttle" else None
        if substep is None:
            return super()._moved_on(actuators, pose, velocity)
        h = pose.new_tensor(self.dt / self.substeps)
        for position in actuators:
            pose, velocity = substep(self._columns, h, position, pose, velocity)
        return pose, velocity

    def _parameters_changed(self) -> None:
        super()._parameters_changed()
        self._physics = SingleTrack(self.values, self.law)
        if self.command.kind != "throttle":  # the kernel is that of a throttle
            return
        size = self.batch_size
        # Of the kernel, [P, *].
        self._columns = torch.stack([self.values[name].expand(size) for name in VALUES])


def _friction(number: str, front: float, rear: float) -> list[Scaled]:
    """Friction of both axles by powers of a number, at the same stiffness B C D."""
    return [
        Scaled(f"{axle}_{factor}", number, side * power)
        for axle, power in (("front", front), ("rear", rear))
        for factor, side in (("grip", 1.0), ("stiffness", -1.0))
    ]


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


VALUES = tuple(name for name, *_ in (*TYRES, *ACTUATION))


def _moved_on(
    values: Tensor, h: Tensor, position: Tensor, pose: Tensor, velocity: Tensor
) -> tuple[Tensor, Tensor]:
    """A substep, with the parameters [P, n] in the order of `VALUES`."""
    named = dict(zip(VALUES, values.unbind(), strict=True))
    return moved_on(SingleTrack(named).substep, named, [position], (pose, velocity), h)


def _example(n: int) -> tuple[Tensor, ...]:
    values = {p.name: p.value for p in declare("buggy", (*TYRES, *ACTUATION))}
    parameters = torch.tensor([values[name] for name in VALUES])[:, None].repeat(1, n)
    pose, velocity = torch.zeros(3, n).T, torch.tensor([2.0, 0.01, 0.1])[:, None].repeat(1, n).T
    return parameters, torch.tensor(0.005), torch.full((2, n), 0.1).T, pose, velocity


KERNEL = Kernel(
    "single_track_substep",
    _moved_on,
    _example,
    (1, None, 0, 0, 0),
)
