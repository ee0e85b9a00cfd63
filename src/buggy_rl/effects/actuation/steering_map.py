"""A steering map that is not a straight line: curved, stopped on one side, dead in the middle."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.actuation.steering import STEERING_MAP, LinkageEffect
from buggy_rl.effects.base import EffectParameter


class SteeringCurve(CommandEffect):
    """A curved map of the steering to the same lock: exponential or saturating.

    Its slope is 1 - c about the centre and 1 + 2 c at full lock. With c > 0, as of the exponential
    setting of a radio, it is less sensitive in the middle; with c < 0, as of a servo horn that has
    turned far or of an arctangent, the last part of the command turns the wheels little.
    """

    name = "steering_curve"
    look_at = (
        "Check exponential (expo, dual rate) in radio or driver, and the angle of the servo horn."
    )
    channel = 1
    equation = "steering' = (1 - curvature) steering + curvature steering^3"
    source = (
        "Ljung 1999, System Identification, 2nd ed., ch. 5 (Hammerstein model, polynomial); "
        f"{STEERING_MAP} has a curved map too"
    )
    declared = (
        EffectParameter(
            "curvature",
            0.0,
            -0.5,
            1.0,
            "-",
            "Share of the cubic term.",
            size=0.25,
            probe=0.05,
            usual=(-0.3, 0.5),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 75 * values["curvature"]  # of full lock, at half of it: 0.5 - 0.5^3 over 0.5
        less = "less" if share >= 0 else "more"
        return (
            f"the steering map is curved: half of the command turns the wheels {abs(share):.3g} % "
            f"{less} than in proportion, full command turns them as far as before"
        )

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        curvature = self._value("curvature")
        return command + curvature * command * (command.square() - 1)


class SteeringEndStop(LinkageEffect):
    """Wheels that stop before full lock, on one side or on both: a stop, or a part in the way."""

    name = "steering_end_stop"
    look_at = "Turn the wheels to both ends by hand: what stops them? Check end points and body."
    equation = "right_cut - 1 <= steering' <= 1 - left_cut"
    source = "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (saturation)"
    declared = tuple(
        EffectParameter(
            f"{side}_cut",
            0.0,
            0.0,
            0.9,
            "-",
            f"Command to the {side} that is lost behind the stop.",
            size=0.25,
            probe=0.1,
            usual=(0.0, 0.4),
        )
        for side in ("left", "right")
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        left, right = (100 * (1 - max(values[f"{s}_cut"], 0.0)) for s in ("left", "right"))
        return (
            f"the wheels meet a stop at {left:.3g} % of the steering to the left and at "
            f"{right:.3g} % to the right"
        )

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        left, right = self._value("left_cut"), self._value("right_cut")
        # A side without a cut has no stop either: not even at full lock.
        stopped = torch.where(left > 0, torch.minimum(command, 1 - left), command)
        return torch.where(right > 0, torch.maximum(stopped, right - 1), stopped)


class SteeringDeadZone(CommandEffect):
    """Dead centre: small commands to either side do nothing, and are missing from larger ones.

    It is where the command is straight ahead; play, which is wherever the servo turns back, is
    `steering_backlash`. Where full lock is reached all the same, the gain is larger too.
    """

    name = "steering_dead_zone"
    look_at = "Check the dead zone of stick or gamepad, and of the servo."
    channel = 1
    equation = "steering' = sign(steering) max(0, |steering| - width)"
    source = "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (dead zone)"
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            0.8,
            "-",
            "Command to either side that does nothing.",
            size=0.06,
            probe=0.02,
            usual=(0.0, 0.12),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 100 * values["width"]
        return f"the first {share:.3g} % of the steering to either side do nothing"

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        width = self._value("width").clamp_min(0.0)
        return command - torch.minimum(torch.maximum(command, -width), width)
