"""Pure pursuit and Stanley: classic trackers of a path, by a point ahead and by the front axle."""

from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.policies.controllers.preview import (
    SpeedConfig,
    ahead,
    allowed_speed,
    curvature,
    heading,
    throttle,
    with_past,
)
from buggy_rl.policies.controllers.tuning import Number, within

CAR = VehicleDimensions()
REAR_AXLE = CAR.sensor_to_cg + CAR.cg_to_rear_axle  # [m] behind the sensor


@dataclass(frozen=True)
class PurePursuitConfig:
    """Distances and gains; `tune` finds them for an engine."""

    shortest: Number = field(default=0.3, metadata=within(0.2, 0.6))
    """Look-ahead of a car that stands [m]."""
    seconds: Number = field(default=0.12, metadata=within(0.0, 0.4))
    """Further look-ahead for each m/s [s]."""
    delay: Number = field(default=0.1, metadata=within(0.0, 0.25))
    """Time from a command to the car's answer [s]."""
    full_lock: Number = field(default=0.36, metadata=within(0.25, 0.5))
    """Road-wheel angle at steering 1 [rad]."""
    understeer: Number = field(default=0.03, metadata=within(0.0, 0.15))
    """Further steering angle with the square of speed [s^2/m^2]."""
    speed: SpeedConfig = field(default_factory=SpeedConfig)


class PurePursuit(TensorDictModuleBase):
    """delta = atan(L kappa (1 + K v^2)),  kappa = 2 y / (x^2 + y^2),  look-ahead = l_0 + T v.

    (x, y) is the path's point at the look-ahead distance, seen from the rear axle after the delay.

    Source: Coulter, Implementation of the pure pursuit path tracking algorithm, 1992.

    Args:
        config: Numbers, or tensors of the batch's shape for a car each its own.
        command: What the car's first command is; a speed's full one in its `full_speed`.
    """

    def __init__(
        self, config: PurePursuitConfig | None = None, command: LongitudinalCommand = ONE_WAY
    ) -> None:
        super().__init__()
        self.command = command
        self.in_keys, self.out_keys = [keys.WAYPOINTS, keys.VELOCITY], [keys.ACTION]
        self.config = config or PurePursuitConfig()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `waypoints` [*, W, 2] and `velocity` [*, 3]."""
        c = self.config
        velocity = tensordict[keys.VELOCITY]
        seen = ahead(tensordict[keys.WAYPOINTS], velocity, c.delay)  # (*, W, 2)
        speed = velocity[..., 0].clamp_min(0.0)
        rear = torch.tensor([REAR_AXLE, 0.0], device=seen.device)
        target = _at_distance(with_past(seen) + rear, c.shortest + c.seconds * speed)
        x, y = target.unbind(-1)
        bend = 2 * y / (x.square() + y.square()).clamp_min(1e-6)
        angle = torch.atan(CAR.wheelbase * bend * (1 + c.understeer * speed.square()))
        steering = (angle / c.full_lock).clamp(-1.0, 1.0)
        drive = throttle(speed, allowed_speed(seen, c.speed), c.speed, self.command)
        tensordict[keys.ACTION] = torch.stack([drive, steering], -1)
        return tensordict


def _at_distance(path: Tensor, distance: Tensor) -> Tensor:
    """First point [*, 2] where a path [*, W, 2] leaves the circle of radius `distance` [*].

    Its last point when it stays inside, its first when it never was.
    """
    begin, end = path[..., :-1, :], path[..., 1:, :]
    step = end - begin
    # |begin + t step|^2 = distance^2, the later of the two solutions
    a = step.square().sum(-1).clamp_min(1e-9)
    b = (begin * step).sum(-1)
    c = begin.square().sum(-1) - distance.square().unsqueeze(-1)
    root = b.square() - a * c
    t = (-b + root.clamp_min(0.0).sqrt()) / a  # (*, W - 1)
    crossing = (root >= 0) & (t >= 0) & (t <= 1)
    inside_at_end = end.square().sum(-1)[..., -1:] < distance.square().unsqueeze(-1)
    index = torch.arange(t.shape[-1], device=t.device)
    nearest = path.square().sum(-1).argmin(-1, keepdim=True).clamp_max(t.shape[-1] - 1)
    first = torch.where(crossing, index, t.shape[-1]).amin(-1, keepdim=True)
    last = torch.full_like(nearest, t.shape[-1] - 1)
    fallback = torch.where(inside_at_end, last, nearest)
    none = first == t.shape[-1]
    chosen = torch.where(none, fallback, first)
    share = torch.where(none, torch.where(inside_at_end, 1.0, 0.0), t.gather(-1, chosen))
    pick = chosen.unsqueeze(-1).expand(*chosen.shape, 2)
    return (begin.gather(-2, pick) + share.unsqueeze(-1) * step.gather(-2, pick)).squeeze(-2)


FRONT_AXLE = CAR.cg_to_front_axle - CAR.sensor_to_cg  # [m] ahead of the sensor


@dataclass(frozen=True)
class StanleyConfig:
    """Gains; `tune` finds them for an engine."""

    gain: Number = field(default=3.0, metadata=within(0.5, 10.0))
    """How fast a distance from the path is closed [1/s]."""
    softening: Number = field(default=1.0, metadata=within(0.2, 3.0))
    """Added to the speed, so that a slow car does not steer wildly [m/s]."""
    delay: Number = field(default=0.1, metadata=within(0.0, 0.25))
    """Time from a command to the car's answer [s]."""
    full_lock: Number = field(default=0.36, metadata=within(0.25, 0.5))
    """Road-wheel angle at steering 1 [rad]."""
    understeer: Number = field(default=0.03, metadata=within(0.0, 0.15))
    """Further steering angle in a bend with the square of speed [s^2/m^2]."""
    yaw_damping: Number = field(default=0.02, metadata=within(0.0, 0.1))
    """Steering against a yaw rate other than the path's [s]."""
    speed: SpeedConfig = field(default_factory=SpeedConfig)


class Stanley(TensorDictModuleBase):
    """delta = psi + atan(k e / (v + v_0)) + L K kappa v^2 + k_r (v kappa - r).

    psi is the path's heading, e its distance to the left of the front axle, kappa its curvature,
    all at the point of the path nearest to the front axle after the delay. In a steady bend psi
    alone is what a car without slip needs, L kappa; K is what slip adds.

    Source: Hoffmann et al., Autonomous automobile trajectory tracking for off-road driving, 2007.

    Args:
        config: Numbers, or tensors of the batch's shape for a car each its own.
        command: What the car's first command is; a speed's full one in its `full_speed`.
    """

    def __init__(
        self, config: StanleyConfig | None = None, command: LongitudinalCommand = ONE_WAY
    ) -> None:
        super().__init__()
        self.command = command
        self.in_keys, self.out_keys = [keys.WAYPOINTS, keys.VELOCITY], [keys.ACTION]
        self.config = config or StanleyConfig()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `waypoints` [*, W, 2] and `velocity` [*, 3]."""
        c = self.config
        velocity = tensordict[keys.VELOCITY]
        seen = ahead(tensordict[keys.WAYPOINTS], velocity, c.delay)  # (*, W, 2)
        speed, yaw_rate = velocity[..., 0].clamp_min(0.0), velocity[..., 2]
        front = torch.tensor([FRONT_AXLE, 0.0], device=seen.device)
        psi, e, kappa = _nearest(with_past(seen) - front)
        slip = CAR.wheelbase * c.understeer * kappa * speed.square()
        angle = psi + torch.atan(c.gain * e / (speed + c.softening)) + slip
        angle = angle + c.yaw_damping * (speed * kappa - yaw_rate)
        steering = (angle / c.full_lock).clamp(-1.0, 1.0)
        drive = throttle(speed, allowed_speed(seen, c.speed), c.speed, self.command)
        tensordict[keys.ACTION] = torch.stack([drive, steering], -1)
        return tensordict


def _nearest(path: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Heading [rad], distance to the left [m] and curvature [1/m] of a path [*, W, 2], each [*].

    At the point that is nearest to the origin, between its second and its last waypoint but one;
    heading and curvature change evenly from waypoint to waypoint.
    """
    chord = path.diff(dim=-2)  # (*, W - 1, 2)
    direction = chord / torch.linalg.vector_norm(chord, dim=-1, keepdim=True).clamp_min(1e-9)
    tangent = direction[..., 1:, :] + direction[..., :-1, :]  # (*, W - 2, 2) at w_1 .. w_W-2
    bend = curvature(path)  # (*, W - 2)
    begin, step = path[..., 1:-2, :], chord[..., 1:-1, :]  # (*, W - 3, 2)
    share = -(begin * step).sum(-1) / step.square().sum(-1).clamp_min(1e-9)
    share = share.clamp(0.0, 1.0).unsqueeze(-1)
    foot = begin + share * step
    index = foot.square().sum(-1).argmin(-1, keepdim=True)  # (*, 1)

    def at(values: Tensor) -> Tensor:
        pick = index.unsqueeze(-1).expand(*index.shape, values.shape[-1])
        return values.gather(-2, pick).squeeze(-2)

    along = at((1 - share) * tangent[..., :-1, :] + share * tangent[..., 1:, :])  # (*, 2)
    kappa = at((1 - share) * bend[..., :-1, None] + share * bend[..., 1:, None]).squeeze(-1)
    x, y = at(foot).unbind(-1)
    psi = heading(along)
    return psi, torch.cos(psi) * y - torch.sin(psi) * x, kappa
