"""What effects on the motion have in common: an acceleration added to what the engine did.

The engine makes a step; then the effect changes the velocity at its end, and moves the pose by
what that velocity would have done on the way. The next step begins from there, because engines
honour what was edited, so the sum is what an engine with that force inside would have done, to
first order in the step.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import Effect, numbers_spec
from buggy_rl.vehicle import VehicleDimensions, integrate_pose, rotate, shift_velocity

LOCK = 0.45  # [rad] further than that no front wheel of such a car turns; chosen
SETTING_OFF = 0.1  # [m/s] forces that a standing car resists come up to 76 % at this speed; chosen


@dataclass(frozen=True)
class Motion:
    """What an engine did in one step, at the centre of gravity."""

    pose: Tensor
    """[n, 3] of the sensor, before the step, world frame."""
    before: Tensor
    """[n, 3] velocity vx, vy [m/s], yaw_rate [rad/s], body frame."""
    after: Tensor
    """[n, 3] likewise, at the end of the step."""
    action: Tensor
    """[n, 2] the command that reached the engine."""
    dt: float
    """[s]"""
    carried: Tensor | None = None
    """[n, size] of the effect's own state before the step, where it has one."""

    @property
    def drive(self) -> Tensor:
        """Drive [n] that was asked for, 0..1."""
        return 0.5 * (self.action[..., 0] + 1)

    @cached_property
    def heading(self) -> Tensor:
        """Yaw [n] in the middle of the step [rad]."""
        return self.pose[..., 2] + 0.5 * self.dt * self.turn_rate

    @cached_property
    def turn_rate(self) -> Tensor:
        """Mean yaw rate [n] of the step [rad/s]."""
        return 0.5 * (self.before[..., 2] + self.after[..., 2])

    @cached_property
    def speed(self) -> Tensor:
        """Speed [n] at the end of the step [m/s]."""
        return torch.linalg.vector_norm(self.after[..., :2], dim=-1)

    @cached_property
    def setting_off(self) -> Tensor:
        """Share [n] in 0..1 that the car moves: tanh(speed / 0.1 m/s), 0 at a standstill."""
        return torch.tanh(self.speed / SETTING_OFF)

    @cached_property
    def acceleration(self) -> tuple[Tensor, Tensor, Tensor]:
        """Force over mass ax, ay [m/s^2] and yaw acceleration [rad/s^2], means of the step [n].

        In the body frame of the middle of the step, a turn by 2 h = r dt between both ends:
        a = (R(h) v' - R(-h) v) / dt, so that a frame that turns adds nothing.
        """
        h = 0.5 * self.dt * self.turn_rate
        start, end = rotate(self.before[..., :2], -h), rotate(self.after[..., :2], h)
        ax, ay = ((end - start) / self.dt).unbind(-1)
        return ax, ay, (self.after[..., 2] - self.before[..., 2]) / self.dt


class MotionEffect(Effect):
    """v' = v_engine + dv, at the centre of gravity, with the pose moved along.

    Args:
        dimensions: Of the car, or those that differ from the buggy's, by name.
        dt, values: As for `Effect`.
    """

    kind = "motion"
    carries: int = 0
    """Numbers of a state of its own; 0 at a reset."""

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

    @property
    def options(self) -> dict[str, Any]:
        shipped = asdict(VehicleDimensions())
        changed = {k: v for k, v in asdict(self.dimensions).items() if v != shipped[k]}
        return super().options | ({"dimensions": changed} if changed else {})

    @abstractmethod
    def _change(self, motion: Motion) -> Tensor:
        """Change [n, 3] of the velocity of the centre of gravity over the step, body frame."""

    def _carried_on(self, motion: Motion) -> tuple[Tensor, Tensor | None]:
        """That change, and the state [n, carries] after the step, where there is one."""
        return self._change(motion), None

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if not (self.active and self.carries):
            return tensordict_reset
        velocity = tensordict_reset.get(keys.VELOCITY)
        none = velocity.new_zeros(*velocity.shape[:-1], self.carries)
        return tensordict_reset.set(self.memory, none)

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        if not self.carries:
            return {}
        return {self.memory: numbers_spec(shape, self.carries, device=device)}

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        next_pose, next_velocity = (
            next_tensordict.get(keys.POSE),
            next_tensordict.get(keys.VELOCITY),
        )
        pose, before, after, action = (
            self._take(part)
            for part in (
                tensordict.get(keys.POSE),
                tensordict.get(keys.VELOCITY),
                next_velocity,
                tensordict.get(keys.ACTION),
            )
        )
        arm = self.dimensions.sensor_to_cg
        at_cg = shift_velocity(torch.stack([before, after]), -arm)
        memory = tensordict.get(self.memory) if self.carries else None
        carried = None if memory is None else self._take(memory)
        change, carried = self._carried_on(
            Motion(pose, at_cg[0], at_cg[1], action.clamp(-1, 1), self.dt, carried)
        )
        if memory is not None and carried is not None:
            next_tensordict.set(self.memory, self._put(memory, carried))
        moved = after + shift_velocity(change, arm)
        # From the origin, so that far from it the difference of both ways is still exact.
        origin = torch.cat([torch.zeros_like(pose[..., :2]), pose[..., 2:]], -1)
        ways = integrate_pose(origin, before, torch.stack([after, moved]), self.dt)
        placed = self._take(next_pose) + (ways[1] - ways[0])
        next_tensordict.set(keys.POSE, self._put(next_pose, placed))
        return next_tensordict.set(keys.VELOCITY, self._put(next_velocity, moved))


def along(x: Tensor) -> Tensor:
    """A change of the velocity [n, 3] by x [n] lengthwise."""
    zero = torch.zeros_like(x)
    return torch.stack([x, zero, zero], -1)


def turning(yaw_rate: Tensor) -> Tensor:
    """A change of the velocity [n, 3] by a yaw rate [n]."""
    zero = torch.zeros_like(yaw_rate)
    return torch.stack([zero, zero, yaw_rate], -1)
