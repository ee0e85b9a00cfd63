"""Forces that are fixed to the room, not to the car.

A standing car is held by its tyres: they come up with tanh(speed / 0.1 m/s). So a car on a
slope neither rolls off by itself nor comes to rest in another way than on the level.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect
from buggy_rl.vehicle import GRAVITY, rotate

SIDE_AREA = 2.0  # side over front; the buggy is about twice as long as it is wide
STREAM = 0.0068  # [1/m] rho c_d A / (2 m): 0.15 m x 0.12 m in front, c_d 1, 1.6 kg
FAINT = 0.03  # [m/s^2] below which the wind's speed grows with its push, not with the root of it


class FloorSlope(MotionEffect):
    """A floor that is not level: the same pull whatever way the car heads."""

    name = "floor_slope"
    equation = "dv_world/dt = (along_x, along_y) tanh(speed / 0.1 m/s)"
    declared = (
        EffectParameter("along_x", 0.0, -3.0, 3.0, "m/s^2", "Pull along world x.", 0.25, 0.03),
        EffectParameter("along_y", 0.0, -3.0, 3.0, "m/s^2", "Pull along world y.", 0.25, 0.03),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        pull = math.hypot(values["along_x"], values["along_y"])
        angle = math.degrees(math.asin(min(pull / GRAVITY, 1.0)))
        down = math.degrees(math.atan2(values["along_y"], values["along_x"]))
        return f"the floor slopes by {angle:.3g} degrees, down towards {down:.0f} degrees from x"

    def _change(self, motion: Motion) -> Tensor:
        world = torch.stack([self._here("along_x"), self._here("along_y")], -1)
        return _pushed(motion, rotate(world.expand(*motion.heading.shape, 2), -motion.heading))


class Wind(MotionEffect):
    """A steady draught: what it adds to the air that the car drives through anyway.

    F(w) = c |w| (w_x, 2 w_y) of an air stream w past the car: it finds twice the area on the side
    that it finds on the front. The wind W adds F(W - v) - F(-v), so it holds a car that drives
    against it by the more, the faster that is. W is told by what it does to a standing car,
    c (1 + 2) / 2 W^2, the mean of front and side. Where on the side the wind presses is left out.
    """

    name = "wind"
    equation = "dv/dt = F(W - v) - F(-v), F(w) = c |w| (w_x, 2 w_y), W along (force_x, force_y)"
    declared = (
        EffectParameter("force_x", 0.0, -3.0, 3.0, "m/s^2", "At rest, along world x.", 0.2, 0.03),
        EffectParameter("force_y", 0.0, -3.0, 3.0, "m/s^2", "At rest, along world y.", 0.2, 0.03),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        push = math.hypot(values["force_x"], values["force_y"])
        towards = math.degrees(math.atan2(values["force_y"], values["force_x"]))
        return (
            f"wind towards {towards:.0f} degrees from x pushes a standing car by {push:.3g} m/s a "
            "second, one that drives against it by more"
        )

    def _change(self, motion: Motion) -> Tensor:
        force = torch.stack([self._here("force_x"), self._here("force_y")], -1)
        size = (force.square().sum(-1, keepdim=True) + FAINT**2).sqrt()
        wind = force / (0.5 * (1 + SIDE_AREA) * STREAM * size).sqrt()  # [m/s]
        still = -motion.after[..., :2]
        blown = still + rotate(wind.expand_as(still), -motion.heading)
        return _pushed(motion, _air(blown) - _air(still))


def _pushed(motion: Motion, acceleration: Tensor) -> Tensor:
    """Change [n, 3] of the velocity by an acceleration [n, 2] that does not turn the car."""
    change = motion.dt * motion.setting_off.unsqueeze(-1) * acceleration
    return torch.cat([change, torch.zeros_like(change[..., :1])], -1)


def _air(stream: Tensor) -> Tensor:
    """Acceleration [n, 2] by an air stream [n, 2] [m/s] past the car."""
    flow = (stream.square().sum(-1, keepdim=True) + 1e-12).sqrt()  # differentiable at none
    return STREAM * flow * stream * stream.new_tensor([1.0, SIDE_AREA])
