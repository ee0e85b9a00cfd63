"""Mounting of the sensor: its place, direction, scale factor and bias."""

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.vehicle import rotate, shift_velocity
from buggy_rl.effects.base import EffectParameter, more_or_less, numbers_spec
from buggy_rl.effects.sensing.base import MemorylessSensing, SensingEffect, sensed_motion

INERTIAL = "Titterton & Weston 2004, Strapdown Inertial Navigation Technology, 2nd ed."


class SensorLeverArm(MemorylessSensing):
    """Lever arm: the sensor measures another point of the car than believed."""

    name = "sensor_lever_arm"
    look_at = "Measure where the tracker sits on the car, from the point that it should show."
    equation = "position + R(yaw) (x, y); vx - y r, vy + x r"
    source = "Siciliano et al. 2009, Robotics, ch. 3 (velocities of the points of a rigid body)"
    declared = (
        EffectParameter(
            "x", 0.0, -5.0, 5.0, "m", "Ahead of its nominal place.", 0.05, 0.01, usual=(-0.14, 0.14)
        ),
        EffectParameter(
            "y", 0.0, -5.0, 5.0, "m", "Left of its nominal place.", 0.05, 0.01, usual=(-0.08, 0.08)
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        x, y = 100 * values["x"], 100 * values["y"]
        lengthwise = f"{abs(x):.2g} cm {'ahead of' if x >= 0 else 'behind'}"
        return (
            f"the sensor sits {lengthwise} and {abs(y):.2g} cm {'left' if y >= 0 else 'right'} of "
            "where it is believed to be"
        )

    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return shifted(pose, velocity, self._value("x"), self._value("y"))

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return shifted(pose, velocity, -self._over_time("x"), -self._over_time("y"))


class SensorYaw(MemorylessSensing):
    """Misalignment: the sensor is turned on the car, and with it all directions it measures."""

    name = "sensor_yaw"
    look_at = "Check the tracker's mount: is it turned against the car's long axis?"
    equation = "yaw + angle; R(-angle) (vx, vy)"
    source = f"{INERTIAL}, ch. 12 (misalignment)"
    declared = (
        EffectParameter(
            "angle", 0.0, -1.6, 1.6, "rad", "Mount, positive left.", 0.05, 0.01, usual=(-0.12, 0.12)
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        angle = math.degrees(values["angle"])
        return f"the sensor is mounted {abs(angle):.2g} degrees to the {_side(angle)}"

    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return _turned(pose, velocity, self._value("angle"))

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return _turned(pose, velocity, -self._over_time("angle"))


class SpeedScale(MemorylessSensing):
    """Scale factor of the measured speed; the position is right: of a wheel encoder.

    Where position and speed are off together, it is `pose_scale`.
    """

    name = "speed_scale"
    look_at = "Check the tracker's scale: drive a measured distance and compare."
    equation = "ratio (vx, vy)"
    source = f"{INERTIAL}, ch. 4 (scale-factor error)"
    declared = (
        EffectParameter(
            "ratio",
            1.0,
            0.2,
            5.0,
            "-",
            "Measured speed over the true one.",
            size=0.03,
            probe=0.01,
            usual=(0.9, 1.1),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the sensor reads {more_or_less(values['ratio'])} speed than there is"

    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return pose, _scaled(velocity, self._value("ratio"))

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return pose, _scaled(velocity, 1 / self._over_time("ratio"))


class PoseScale(MemorylessSensing):
    """Scale factor of position and speed together, as of a tracker whose map is too large.

    A visual-inertial tracker filters both from the same images and the same accelerometer: where
    its scale is off, all its lengths are. Angles are right.
    """

    name = "pose_scale"
    look_at = "Push the car a measured 2 m: does the tracker show 2 m?"
    equation = "ratio (x, y); ratio (vx, vy)"
    source = "Scaramuzza & Fraundorfer 2011, IEEE Robot. Autom. Mag. 18(4), Visual Odometry (scale)"
    declared = (
        EffectParameter(
            "ratio",
            1.0,
            0.2,
            5.0,
            "-",
            "Measured length over the true one.",
            size=0.05,
            probe=0.01,
            usual=(0.85, 1.15),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"the tracker shows {more_or_less(values['ratio'])} way and speed than there is: the "
            "scale of its map is off"
        )

    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        ratio = self._value("ratio")
        return _scaled(pose, ratio), _scaled(velocity, ratio)

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        ratio = 1 / self._over_time("ratio")
        return _scaled(pose, ratio), _scaled(velocity, ratio)


class GyroBias(MemorylessSensing):
    """Bias of the measured yaw rate; the heading is measured by itself and is right."""

    name = "gyro_bias"
    look_at = "Let the car stand still: does the yaw rate read 0?"
    equation = "yaw_rate + bias"
    source = f"{INERTIAL}, ch. 4 (fixed bias)"
    declared = (
        EffectParameter(
            "bias", 0.0, -2.0, 2.0, "rad/s", "Measured at rest.", 0.02, 0.01, usual=(-0.1, 0.1)
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        bias = math.degrees(values["bias"])
        return f"the gyroscope reads {abs(bias):.3g} degrees/s to the {_side(bias)} at a standstill"

    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return pose, biased(velocity, self._value("bias"))

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return pose, biased(velocity, -self._over_time("bias"))


def shifted(pose: Tensor, velocity: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] of the point (x, y) [m] of the body frame."""
    yaw = pose[..., 2]
    arm = torch.stack([x, y], -1).expand(*yaw.shape, 2)
    position = pose[..., :2] + rotate(arm, yaw)
    return torch.cat([position, pose[..., 2:]], -1), shift_velocity(velocity, x, y)


def _turned(pose: Tensor, velocity: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] in a body frame turned to the left by an angle [rad]."""
    yaw = pose[..., 2:] + angle.unsqueeze(-1)
    planar = rotate(velocity[..., :2], (-angle).expand(velocity.shape[:-1]))
    return (
        torch.cat([pose[..., :2], yaw.expand(*pose.shape[:-1], 1)], -1),
        torch.cat([planar, velocity[..., 2:]], -1),
    )


def _scaled(velocity: Tensor, ratio: Tensor) -> Tensor:
    """A velocity or pose [*, 3] with vx and vy, or x and y, times a ratio; not what turns."""
    return torch.cat([velocity[..., :2] * ratio.unsqueeze(-1), velocity[..., 2:]], -1)


def biased(velocity: Tensor, bias: Tensor) -> Tensor:
    """The velocity [*, 3] with a bias [rad/s] added to the yaw rate."""
    return torch.cat([velocity[..., :2], velocity[..., 2:] + bias.unsqueeze(-1)], -1)


def _side(value: float) -> str:
    return "left" if value >= 0 else "right"


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
        pose, velocity = sensed_motion(state)
        memory = given.get(self.memory, None)  # of an episode that goes on
        error = torch.zeros_like(pose) if memory is None else memory[..., :3]
        others = pose - state.get(keys.POSE)
        state.set(self.memory, torch.cat([error, others], -1))
        rows = self._gather(pose) + self._gather(error), self._gather(velocity)
        self._set_measured(state, (pose, velocity), rows)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        pose, velocity = sensed_motion(after)
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

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        rows = torch.arange(pose.shape[-2], device=pose.device)
        error = self._over_time("rate") * dt * rows  # (*, T) of the heading
        way = pose[..., :2].diff(dim=-2)
        middle = 0.5 * (error[..., 1:] + error[..., :-1])
        way = rotate(way, -middle.expand(way.shape[:-1]))
        position = torch.cat([pose[..., :1, :2], pose[..., :1, :2] + way.cumsum(-2)], -2)
        yaw = pose[..., 2] - error
        return torch.cat([position, yaw.unsqueeze(-1)], -1), velocity
