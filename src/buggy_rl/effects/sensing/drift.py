"""Heading of a tracker that drifts, and with it the path that it shows."""

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import EffectParameter, numbers_spec
from buggy_rl.effects.sensing.base import SensingEffect, measured
from buggy_rl.effects.sensing.mounting import INERTIAL, over_time
from buggy_rl.vehicle import rotate

MINUTE = 60.0  # [s]


class HeadingDrift(SensingEffect):
    """The heading error of visual-inertial odometry grows with time, and bends the path.

    The tracker sums up ways along the heading that it believes in, so each step of the path is
    turned by the error that the heading has by then. Velocities in the body frame and the yaw rate
    are right. The memory [6] is the error of x, y [m] and yaw [rad], 0 after a reset because nobody
    knows where a drift began, and what the sensing effects nearer to the engine add to the pose.
    """

    name = "heading_drift"
    look_at = (
        "Let the car stand for a minute and watch the heading: tracker features, gyroscope bias."
    )
    equation = "yaw + rate t; each step of the position turned by rate t"
    source = f"{INERTIAL}, ch. 11 (propagation of heading errors)"
    declared = (
        EffectParameter(
            "rate",
            0.0,
            -1.0,
            1.0,
            "rad/s",
            "Growth of the heading's error, to the left.",
            size=0.01,
            probe=0.003,
            usual=(-0.01, 0.01),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        rate = math.degrees(values["rate"]) * MINUTE
        return (
            f"the tracker's heading drifts by {abs(rate):.3g} degrees a minute to the "
            f"{'left' if rate >= 0 else 'right'}, and its path bends with it"
        )

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        pose, velocity = measured(state)
        others = pose - state.get(keys.POSE)
        state.set(self.memory, torch.cat([torch.zeros_like(pose), others], -1))
        self._set_measured(state, (pose, velocity), (self._gather(pose), self._gather(velocity)))

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        pose, velocity = measured(after)
        memory, rate = before.get(self.memory), self._value("rate")
        error, others = self._gather(memory).split(3, -1)
        now = self._gather(pose)
        # From the pose before the step as it is now: it may have been edited since.
        way = (now - others - self._gather(before.get(keys.POSE)))[..., :2]
        turn = (error[..., 2] + 0.5 * self.dt * rate).expand(way.shape[:-1])
        position = error[..., :2] + rotate(way, turn) - way
        heading = error[..., 2:] + (self.dt * rate).unsqueeze(-1)
        error = torch.cat([position, heading.expand(*position.shape[:-1], 1)], -1)
        others = now - self._gather(after.get(keys.POSE))
        after.set(self.memory, self._scatter(memory, torch.cat([error, others], -1)))
        self._set_measured(after, (pose, velocity), (now + error, self._gather(velocity)))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, 6, device=device)}

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        rows = torch.arange(pose.shape[-2], device=pose.device)
        error = over_time(self.values)["rate"] * dt * rows  # (*, T) of the heading
        way = pose[..., :2].diff(dim=-2)
        middle = 0.5 * (error[..., 1:] + error[..., :-1])
        way = rotate(way, -middle.expand(way.shape[:-1]))
        position = torch.cat([pose[..., :1, :2], pose[..., :1, :2] + way.cumsum(-2)], -2)
        yaw = pose[..., 2] - error
        return torch.cat([position, yaw.unsqueeze(-1)], -1), velocity
