"""What effects on the motion have in common: an acceleration added to the engine's.

After a step of the engine, the effect changes the velocity at its end, and the pose by the way that
the changed velocity makes more. The engine's next step starts from the edited state, so the result
is that of an engine with the force inside, to first order in the step.
"""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.kernels import Kernel
from buggy_rl.core.longitudinal import ONE_WAY_REST
from buggy_rl.core.vehicle import (
    VehicleDimensions,
    integrate_pose,
    planar_norm,
    shift_velocity,
    side_by_side_columns,
)
from buggy_rl.effects.base import Effect, at_rows, numbers_spec, with_rows


def centred(numbers: Tensor, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """Velocities of the centre of gravity.

    Args:
        numbers: [2] distance of the sensor ahead of it [m], step [s].
        start: [n, 3] velocity at the sensor before the step, body frame.
        end: [n, 3] likewise, after it.

    Returns:
        Both [n, 3] at the centre of gravity.
    """
    arm, _ = numbers.unbind(-1)
    return shift_velocity(start, -arm), shift_velocity(end, -arm)


def mean_acceleration(numbers: Tensor, before: Tensor, after: Tensor) -> tuple[Tensor]:
    """Force over mass and yaw acceleration, means of a step.

    In the body frame of the middle of the step, between whose ends it turns by 2 h = r dt:
    a = (R(h) v' - R(-h) v) / dt, without the apparent forces of a turning frame.

    Args:
        numbers: [1] step [s].
        before: [n, 3] velocity of the centre of gravity, body frame.
        after: [n, 3] likewise.

    Returns:
        [n, 3] ax, ay [m/s^2], yaw acceleration [rad/s^2].
    """
    (dt,) = numbers.unbind(-1)
    (vx, vy, r), (vx_after, vy_after, r_after) = before.unbind(-1), after.unbind(-1)
    h = 0.25 * dt * (r + r_after)
    cos, sin = torch.cos(h), torch.sin(h)
    ax = (cos * vx_after - sin * vy_after) - (cos * vx + sin * vy)
    ay = (sin * vx_after + cos * vy_after) - (cos * vy - sin * vx)
    return (side_by_side_columns(ax / dt, ay / dt, (r_after - r) / dt),)


def motion_after_change(
    numbers: Tensor, pose: Tensor, start: Tensor, end: Tensor, change: Tensor, next_pose: Tensor
) -> tuple[Tensor, Tensor]:
    """Pose and velocity after a step whose velocity at the centre of gravity is changed.

    Args:
        numbers: [2] distance of the sensor ahead of the centre of gravity [m], step [s].
        pose: [n, 3] of the sensor before the step.
        start: [n, 3] its velocity before the step.
        end: [n, 3] after it.
        change: [n, 3] of the velocity of the centre of gravity over the step.
        next_pose: [n, 3] of the sensor after the step, without the change.

    Returns:
        Pose and velocity [n, 3] of the sensor after it.
    """
    arm, dt = numbers.unbind(-1)
    changed = end + shift_velocity(change, arm)
    # Both ways begin at x = y = 0: of poses far from there the difference would be rounded.
    yaw = pose[..., 2]
    origin = side_by_side_columns(torch.zeros_like(yaw), torch.zeros_like(yaw), yaw)
    way = integrate_pose(origin, start, changed, dt) - integrate_pose(origin, start, end, dt)
    return next_pose + way, changed


def _rows(count: int, n: int) -> tuple[Tensor, ...]:
    return tuple(torch.tensor([1.0, 0.1, 0.2])[:, None].repeat(1, n).T for _ in range(count))


CENTRED = Kernel("centred", centred, lambda n: (torch.ones(2), *_rows(2, n)), (None, 0, 0))
MEAN_ACCELERATION = Kernel(
    "mean_acceleration", mean_acceleration, lambda n: (torch.ones(1), *_rows(2, n)), (None, 0, 0)
)
MOVED = Kernel(
    "moved", motion_after_change, lambda n: (torch.ones(2), *_rows(5, n)), (None, 0, 0, 0, 0, 0)
)


LOCK = 0.45  # [rad] largest road-wheel angle; DART's locks are 0.32 and 0.40
TYPICAL_STIFFNESS = (6.1, 9.4)  # [1/rad] over load, front and rear: B C D of DART's axles
SETTING_OFF = 0.1  # [m/s] speed at which a force that rest cancels reaches tanh(1) = 76 %; chosen


@dataclass(frozen=True)
class Motion:
    """The engine's step at the centre of gravity, n rows."""

    pose: Tensor
    """[n, 3] of the sensor, before the step, world frame."""
    before: Tensor
    """[n, 3] velocity vx, vy [m/s], yaw_rate [rad/s], body frame."""
    after: Tensor
    """[n, 3] likewise, at the end of the step."""
    action: Tensor
    """[n, 2] the command that reached the engine, as of a one-way car: -1 is no drive, or brake."""
    dt: float
    """[s]"""
    state: Tensor | None = None
    """[n, state_size] the effect's latent state before the step, where it has one."""
    asked: Tensor | None = None
    """[n] the command of a car with reverse, -1..1; None of one without."""

    def split(self, sizes: Sequence[int]) -> Iterator["Motion"]:
        """Parts of so many rows, without latent states."""
        seen = (self.pose, self.before, self.after, self.action)
        for pose, before, after, action in zip(*(part.split(sizes) for part in seen), strict=True):
            yield Motion(pose, before, after, action, self.dt)

    @property
    def drive(self) -> Tensor:
        """Drive command [n], 0..1; 0 where a car brakes or reverses."""
        return 0.5 * (self.action[..., 0] + 1)

    def rolling(self, slowest: float) -> Tensor:
        """Vx [n] after the step, at least `slowest` [m/s] forward, or backward with reverse."""
        vx = self.after[..., 0]
        if self.asked is None:
            return vx.clamp_min(slowest)
        return torch.where(vx < 0, vx.clamp_max(-slowest), vx.clamp_min(slowest))

    @property
    def heading(self) -> Tensor:
        """Yaw [n] in the middle of the step [rad]."""
        return self.pose[..., 2] + 0.5 * self.dt * self.turn_rate

    @property
    def turn_rate(self) -> Tensor:
        """Yaw rate [n], mean of the step [rad/s]."""
        return 0.5 * (self.before[..., 2] + self.after[..., 2])

    @property
    def speed(self) -> Tensor:
        """Speed [n] at the end of the step [m/s]."""
        return planar_norm(self.after[..., 0], self.after[..., 1])

    @property
    def setting_off(self) -> Tensor:
        """tanh(speed / 0.1 m/s) [n]: 0 at rest, 1 in motion."""
        return torch.tanh(self.speed / SETTING_OFF)

    @property
    def acceleration(self) -> tuple[Tensor, Tensor, Tensor]:
        """`mean_acceleration`: ax, ay [m/s^2] and yaw acceleration [rad/s^2], each [n]."""
        numbers = torch.as_tensor(self.dt, dtype=self.after.dtype, device=self.after.device)
        acceleration = MEAN_ACCELERATION.fastest(self.after[..., 2])
        (found,) = acceleration(numbers.reshape(1), self.before, self.after)
        ax, ay, turning = found.unbind(-1)
        return ax, ay, turning


class MotionEffect(Effect):
    """v' = v_engine + dv at the centre of gravity, and the pose with it.

    Args:
        dimensions: Of the car, or those that differ from the buggy's, by name.
        dt, values: As for `Effect`.
    """

    kind = "motion"
    may_delay = False
    state_size: int = 0
    """Numbers of its latent state, which is 0 after a reset."""

    def __init__(
        self,
        *,
        dimensions: VehicleDimensions | Mapping[str, float] | None = None,
        **rest: Any,
    ) -> None:
        if not isinstance(dimensions, VehicleDimensions):
            dimensions = VehicleDimensions(**(dimensions or {}))
        self.dimensions = dimensions
        super().__init__(**rest)
        numbers = torch.tensor([dimensions.sensor_to_cg, self.dt])
        self.register_buffer("step_numbers", numbers, persistent=False)

    @property
    def options(self) -> dict[str, Any]:
        shipped = asdict(VehicleDimensions())
        changed = {k: v for k, v in asdict(self.dimensions).items() if v != shipped[k]}
        return ({"dimensions": changed} if changed else {}) | super().options

    @abstractmethod
    def _change(self, motion: Motion) -> Tensor:
        """Change [n, 3] of the velocity of the centre of gravity over the step, body frame."""

    def _change_and_state(self, motion: Motion) -> tuple[Tensor, Tensor | None]:
        """Change of the velocity, and the latent state [n, state_size] after the step, if any."""
        return self._change(motion), None

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        if self.state_size:
            velocity = state.get(keys.VELOCITY)
            state.set(self.memory, velocity.new_zeros(*velocity.shape[:-1], self.state_size))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        if not self.state_size:
            return {}
        return {self.memory: numbers_spec(shape, self.state_size, device=device)}

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        step_together([self], self.rows, before, after)

    def _changed(self, motion: Motion, before: TensorDictBase, after: TensorDictBase) -> Tensor:
        """Change of the velocity [n, 3] in its rows; the latent state is written into `after`."""
        memory = before.get(self.memory) if self.state_size else None
        if memory is not None:
            motion = replace(motion, state=self._gather(memory))
        if self.rest != ONE_WAY_REST:
            asked, steering = motion.action.unbind(-1)
            action = torch.stack([2 * asked.clamp_min(0.0) - 1, steering], -1)
            motion = replace(motion, action=action, asked=asked)
        change, state = self._change_and_state(motion)
        if memory is not None and state is not None:
            after.set(self.memory, self._scatter(memory, state))
        return change


def step_together(
    effects: Sequence[MotionEffect],
    rows: Tensor | None,
    before: TensorDictBase,
    after: TensorDictBase,
) -> None:
    """Writes the steps of motion effects that act on separate rows of one car, in one pass.

    Args:
        effects: One or more, of the same dimensions and control period.
        rows: Theirs, one after another; None for a single effect in all of them.
        before: State before the step.
        after: The engine's state after it, which is edited.
    """
    next_pose, next_velocity = after.get(keys.POSE), after.get(keys.VELOCITY)
    seen = (before.get(keys.POSE), before.get(keys.VELOCITY), before.get(keys.ACTION))
    pose, start, action = (at_rows(part, rows) for part in seen)
    placed, end = at_rows(next_pose, rows), at_rows(next_velocity, rows)
    first, row = effects[0], end[..., 2]
    numbers = first._tensor("step_numbers").to(end.dtype)
    at_cg = CENTRED.fastest(row)(numbers, start, end)
    whole = Motion(pose, at_cg[0], at_cg[1], action.clamp(-1, 1), first.dt)
    if len(effects) == 1:
        change = first._changed(whole, before, after)
    else:
        sizes = [len(effect._tensor("active_rows")) for effect in effects]
        each = zip(effects, whole.split(sizes), strict=True)
        changes = [effect._changed(own, before, after) for effect, own in each]
        change = torch.cat([own.T for own in changes], 1).T  # the batch last in memory
    moved, changed = MOVED.fastest(row)(numbers, pose, start, end, change, placed)
    after.set(keys.POSE, with_rows(next_pose, rows, moved))
    after.set(keys.VELOCITY, with_rows(next_velocity, rows, changed))


def along(vx: Tensor) -> Tensor:
    """Change of the velocity [n, 3] by vx [n] alone."""
    zero = torch.zeros_like(vx)
    return torch.stack([vx, zero, zero], -1)


def turning(yaw_rate: Tensor) -> Tensor:
    """Change of the velocity [n, 3] by a yaw rate [n] alone."""
    zero = torch.zeros_like(yaw_rate)
    return torch.stack([zero, zero, yaw_rate], -1)
