"""Where the sensor sits, which way it looks, and what it takes for a metre or a standstill."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter, one_in
from buggy_rl.effects.sensing.base import InstantSensing
from buggy_rl.vehicle import rotate, shift_velocity


class SensorLeverArm(InstantSensing):
    """The sensor sits elsewhere on the car: its pose and velocity are those of that point."""

    name = "sensor_lever_arm"
    equation = "position + R(yaw) (x, y); vx - y r, vy + x r"
    declared = (
        EffectParameter("x", 0.0, -0.5, 0.5, "m", "Ahead of its nominal place.", 0.05, 0.01),
        EffectParameter("y", 0.0, -0.5, 0.5, "m", "Left of its nominal place.", 0.05, 0.01),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        x, y = 100 * values["x"], 100 * values["y"]
        lengthwise = f"{abs(x):.2g} cm {'ahead of' if x >= 0 else 'behind'}"
        return (
            f"the sensor sits {lengthwise} and {abs(y):.2g} cm {'left' if y >= 0 else 'right'} of "
            "where it is believed to be"
        )

    def _sensed(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return shifted(pose, velocity, self._here("x"), self._here("y"))

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        values = over_time(self.values)
        return shifted(pose, velocity, -values["x"], -values["y"])


class SensorYaw(InstantSensing):
    """The sensor is turned on the car, and so is all that it says of directions."""

    name = "sensor_yaw"
    equation = "yaw + angle; R(-angle) (vx, vy)"
    declared = (
        EffectParameter("angle", 0.0, -1.6, 1.6, "rad", "Mount, positive left.", 0.05, 0.01),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        angle = math.degrees(values["angle"])
        return f"the sensor is mounted {abs(angle):.2g} degrees to the {_side(angle)}"

    def _sensed(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return turned(pose, velocity, self._here("angle"))

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return turned(pose, velocity, -over_time(self.values)["angle"])


class SpeedScale(InstantSensing):
    """Speeds are read too large or too small; the position is right."""

    name = "speed_scale"
    equation = "ratio (vx, vy)"
    declared = (
        EffectParameter("ratio", 1.0, 0.2, 5.0, "-", "Speed read over the true one.", 0.08, 0.01),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the sensor reads {one_in(values['ratio'])} speed than there is"

    def _sensed(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return pose, scaled(velocity, self._here("ratio"))

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return pose, scaled(velocity, 1 / over_time(self.values)["ratio"])


class GyroBias(InstantSensing):
    """The yaw rate is read off by a constant; the heading, seen and not summed up, is right."""

    name = "gyro_bias"
    equation = "yaw_rate + bias"
    declared = (
        EffectParameter("bias", 0.0, -2.0, 2.0, "rad/s", "Read at a standstill.", 0.08, 0.01),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        bias = math.degrees(values["bias"])
        return f"the gyroscope reads {abs(bias):.3g} degrees/s to the {_side(bias)} at a standstill"

    def _sensed(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        return pose, biased(velocity, self._here("bias"))

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        return pose, biased(velocity, -over_time(self.values)["bias"])


def over_time(values: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Values of the batch's shape, with a dimension for the rows of a record where there is one."""
    return {k: v.unsqueeze(-1) if v.dim() else v for k, v in values.items()}


def shifted(pose: Tensor, velocity: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] of another point (x, y) of the car."""
    yaw = pose[..., 2]
    arm = torch.stack([x, y], -1).expand(*yaw.shape, 2)
    position = pose[..., :2] + rotate(arm, yaw)
    return torch.cat([position, pose[..., 2:]], -1), shift_velocity(velocity, x, y)


def turned(pose: Tensor, velocity: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] in a body frame turned to the left by an angle."""
    yaw = pose[..., 2:] + angle.unsqueeze(-1)
    over_floor = rotate(velocity[..., :2], (-angle).expand(velocity.shape[:-1]))
    return (
        torch.cat([pose[..., :2], yaw.expand(*pose.shape[:-1], 1)], -1),
        torch.cat([over_floor, velocity[..., 2:]], -1),
    )


def scaled(velocity: Tensor, ratio: Tensor) -> Tensor:
    """The velocity [*, 3] with its speeds, not its yaw rate, times a ratio."""
    return torch.cat([velocity[..., :2] * ratio.unsqueeze(-1), velocity[..., 2:]], -1)


def biased(velocity: Tensor, bias: Tensor) -> Tensor:
    """The velocity [*, 3] with a yaw rate off by a bias."""
    return torch.cat([velocity[..., :2], velocity[..., 2:] + bias.unsqueeze(-1)], -1)


def _side(value: float) -> str:
    return "left" if value >= 0 else "right"
