"""Forces with a fixed direction in the world: slope and wind.

Tyres hold a car at rest, so both forces are multiplied by tanh(speed / 0.1 m/s): a car on a slope
neither rolls off by itself nor comes to rest in another way than on the level.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions, rotate
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect

SIDE_AREA = 2.0  # [-] side over frontal area: 0.273 m of length over about 0.14 m of width
STREAM = 0.0068  # [1/m] of the buggy, rho c_d A / (2 m): 1.2 kg/m^3, 0.15 m x 0.12 m, 1.6 kg
FAINT = 0.03  # [m/s^2] push below which the wind speed is linear in it instead of its root; chosen


class FloorSlope(MotionEffect):
    """A floor that is not level: a constant acceleration in the world."""

    name = "floor_slope"
    look_at = "Put a spirit level on the floor: does the car roll by itself?"
    equation = "dv_world/dt = (along_x, along_y) tanh(speed / 0.1 m/s)"
    source = "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., eq. (4.1) (m g sin(slope))"
    declared = (
        EffectParameter(
            "along_x", 0.0, -3.0, 3.0, "m/s^2", "Pull along world x.", 0.2, 0.03, usual=(-0.3, 0.3)
        ),
        EffectParameter(
            "along_y", 0.0, -3.0, 3.0, "m/s^2", "Pull along world y.", 0.2, 0.03, usual=(-0.3, 0.3)
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        pull = math.hypot(values["along_x"], values["along_y"])
        angle = math.degrees(math.asin(min(pull / GRAVITY, 1.0)))
        down = math.degrees(math.atan2(values["along_y"], values["along_x"]))
        return f"the floor slopes by {angle:.3g} degrees, down towards {down:.0f} degrees from x"

    def _change(self, motion: Motion) -> Tensor:
        world = torch.stack([self._value("along_x"), self._value("along_y")], -1)
        return _pushed(motion, rotate(world.expand(*motion.heading.shape, 2), -motion.heading))


class Wind(MotionEffect):
    """Steady wind, added to the still air whose drag the simulator has.

    An air stream w past the car gives F(w) = c |w| (w_x, 2 w_y), with twice the area from the side
    than from the front. c = rho c_d A / (2 m) is the buggy's, over the car's length in buggies: of
    similar bodies A goes with L^2 and m with L^3. The side's area goes with length over track
    width: 2 of the buggy. The wind W adds F(W - v) - F(-v), which grows with the speed against it.
    The parameters are the acceleration of a car at rest, c (1 + 2) / 2 W^2, mean of front and
    side. The yaw moment is left out.
    """

    name = "wind"
    look_at = "Look for moving air: fans, air conditioning, open doors; outdoors the wind."
    equation = "dv/dt = F(W - v) - F(-v), F(w) = c |w| (w_x, 2 w_y), W along (force_x, force_y)"
    source = "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., sec. 4.1.1 (drag with wind)"
    declared = (
        EffectParameter(
            "force_x",
            0.0,
            -3.0,
            3.0,
            "m/s^2",
            "At rest, along world x.",
            0.1,
            0.03,
            usual=(-0.3, 0.3),
        ),
        EffectParameter(
            "force_y",
            0.0,
            -3.0,
            3.0,
            "m/s^2",
            "At rest, along world y.",
            0.1,
            0.03,
            usual=(-0.3, 0.3),
        ),
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
        force = torch.stack([self._value("force_x"), self._value("force_y")], -1)
        size = (force.square().sum(-1, keepdim=True) + FAINT**2).sqrt()
        stream, side = air_of(self.dimensions)
        wind = force / (0.5 * (1 + side) * stream * size).sqrt()  # [m/s]
        still = -motion.after[..., :2]
        blown = still + rotate(wind.expand_as(still), -motion.heading)
        return _pushed(motion, _air(blown, stream, side) - _air(still, stream, side))


def _pushed(motion: Motion, acceleration: Tensor) -> Tensor:
    """Change [n, 3] of the velocity by an acceleration [n, 2] that does not turn the car."""
    change = motion.dt * motion.setting_off.unsqueeze(-1) * acceleration
    return torch.cat([change, torch.zeros_like(change[..., :1])], -1)


def air_of(car: VehicleDimensions) -> tuple[float, float]:
    """Stream c [1/m] of a car from the front, and the area of its side over that of its front."""
    buggy = VehicleDimensions()
    slender = (car.length / car.track_width) / (buggy.length / buggy.track_width)
    return STREAM * buggy.wheelbase / car.wheelbase, SIDE_AREA * slender


def _air(stream: Tensor, front: float, side: float) -> Tensor:
    """Acceleration [n, 2] [m/s^2] by an air stream [n, 2] [m/s] past the car."""
    flow = (stream.square().sum(-1, keepdim=True) + 1e-12).sqrt()  # differentiable at 0
    return front * flow * stream * stream.new_tensor([1.0, side])
