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


class FloorSlope(MotionEffect):
    """A floor that is not level: the same pull whatever way the car heads."""

    name = "floor_slope"
    equation = "dv_world/dt = (along_x, along_y) tanh(speed / 0.1 m/s)"
    parameters = (
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
        return _felt(motion, self._here("along_x"), self._here("along_y"), 1.0)


class Wind(MotionEffect):
    """A steady draught: it finds twice the area on the car's side that it finds on its front.

    That the car's own motion adds to the wind, and where on the side the wind presses, is left
    out.
    """

    name = "wind"
    equation = "dv/dt = diag(1, 2) R(-yaw) (force_x, force_y) tanh(speed / 0.1 m/s)"
    parameters = (
        EffectParameter("force_x", 0.0, -3.0, 3.0, "m/s^2", "On the front, world x.", 0.2, 0.03),
        EffectParameter("force_y", 0.0, -3.0, 3.0, "m/s^2", "On the front, world y.", 0.2, 0.03),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        push = math.hypot(values["force_x"], values["force_y"])
        towards = math.degrees(math.atan2(values["force_y"], values["force_x"]))
        return (
            f"wind towards {towards:.0f} degrees from x pushes the car by {push:.3g} m/s a second "
            "lengthwise, twice that from the side"
        )

    def _change(self, motion: Motion) -> Tensor:
        return _felt(motion, self._here("force_x"), self._here("force_y"), SIDE_AREA)


def _felt(motion: Motion, x: Tensor, y: Tensor, side: float) -> Tensor:
    """Change [n, 3] of the velocity by a world-frame acceleration, `side` times as much across."""
    world = torch.stack([x, y], -1).expand(*motion.heading.shape, 2)
    ax, ay = rotate(world, -motion.heading).unbind(-1)
    step = motion.dt * motion.setting_off
    return torch.stack([ax * step, side * ay * step, torch.zeros_like(ax)], -1)
