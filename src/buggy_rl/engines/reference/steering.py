"""From steering command to the directions of the front wheels: servo and linkage."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.engines.reference.wheels import sides


class Steering:
    """A servo that moves a linkage which turns the front wheels.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        track_width: [m].
        wheelbase: [m].
    """

    def __init__(self, values: Mapping[str, Tensor], track_width: float, wheelbase: float) -> None:
        self.values = values
        left, right = values["lock_left"], values["lock_right"]
        self.gain = 0.5 * (left + right)
        self.asymmetry = 0.5 * (left - right)
        self.trim = values["steering_trim"]
        self.splay = sides(self.trim) * values["ackermann"] * (0.5 * track_width / wheelbase)

    def moved(self, servo: Tensor, command: Tensor, dt: float) -> Tensor:
        """Servo position [*] after a step towards the command [*], both in [-1, 1].

        ds/dt = clip((c - s) / tau, -rate, rate), exact where the rate does not limit.
        """
        follow = -torch.expm1(-dt / self.values["steering_lag"])
        step = self.values["steering_rate"] * dt
        return servo + torch.clamp((command - servo) * follow, -step, step)

    def angle(self, servo: Tensor) -> Tensor:
        """Mean road-wheel angle [*] [rad]: a linkage with a longer way to one side.

        delta = a s + b s^2 + trim, with a + b the left lock and a - b the right one.
        """
        return servo * (self.gain + self.asymmetry * servo) + self.trim

    def servo_at(self, angle: Tensor) -> Tensor:
        """Servo position [*] that makes a road-wheel angle [*] [rad], within [-1, 1]."""
        x = angle - self.trim
        root = (self.gain.square() + 4.0 * self.asymmetry * x).clamp_min(0.0).sqrt()
        return (2.0 * x / (self.gain + root)).clamp(-1.0, 1.0)

    def directions(self, servo: Tensor) -> tuple[Tensor, Tensor]:
        """Cosine and sine [4, *] of the angle of each wheel.

        cot(delta_i) = cot(delta) -+ k t / (2 L): the inner wheel is turned more, with k = 1 so
        that all wheels roll about one point.
        """
        angle = self.angle(servo)
        sin = torch.sin(angle)
        forward = torch.cos(angle) - self.splay * sin  # (2, *)
        scale = torch.rsqrt(forward.square() + sin.square())
        straight = torch.zeros_like(forward)
        return torch.cat([forward * scale, straight + 1.0]), torch.cat([sin * scale, straight])
