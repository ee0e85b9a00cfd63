"""Another static map from command to road-wheel angle, before the servo or behind it."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.actuation.servo import LinkageMap
from buggy_rl.effects.base import EffectParameter, more_or_less

STEERING_MAP = "Lyons et al. 2024, DART, dart_dynamic_models.py"


class SteeringGain(CommandEffect):
    """Another gain of the steering; beyond full lock where the engine goes on there."""

    name = "steering_gain"
    channel = 1
    extends = True
    look_at = (
        "Measure the wheels' angle at full command: servo end points (EPA), horn length, linkage."
    )
    equation = "steering' = gain steering"
    source = f"{STEERING_MAP} (slope of the map from steering command to road-wheel angle)"
    declared = (
        EffectParameter(
            "gain",
            1.0,
            0.1,
            4.0,
            "-",
            "Steering that acts over steering given.",
            size=0.2,
            probe=0.02,
            usual=(0.75, 1.3),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the wheels turn {more_or_less(values['gain'])} than the steering says"

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return self._value("gain") * command


class SteeringOffset(CommandEffect):
    """Road wheels that are not straight at zero command: a trim, within the servo's way."""

    name = "steering_offset"
    channel = 1
    look_at = "Check the steering trim and that the servo horn is centred when the command is 0."
    equation = "steering' = clip(steering + offset, -1, 1)"
    source = f"{STEERING_MAP} (offset of the map from steering command to road-wheel angle)"
    declared = (
        EffectParameter(
            "offset",
            0.0,
            -0.8,
            0.8,
            "-",
            "Added to the steering command.",
            size=0.15,
            probe=0.01,
            usual=(-0.2, 0.2),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        side = "left" if values["offset"] >= 0 else "right"
        share = 100 * abs(values["offset"])
        return f"the car pulls to the {side}, as if steered by {share:.3g} % of full lock"

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return command + self._value("offset")


class SteeringAsymmetry(LinkageMap):
    """Another gain to the left than to the right.

    Left times sqrt(q), right over sqrt(q): a gain common to both is `steering_gain`.
    """

    name = "steering_asymmetry"
    look_at = (
        "Measure the wheels' angle at full left and full right: end points, length of both rods."
    )
    equation = "steering' = sqrt(q) steering to the left, steering / sqrt(q) to the right"
    source = f"{STEERING_MAP} (separate branches of that map to the left and to the right)"
    declared = (
        EffectParameter(
            "left_to_right",
            1.0,
            0.2,
            5.0,
            "-",
            "Gain to the left over gain right.",
            size=0.22,
            probe=0.02,
            usual=(0.75, 1.35),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = more_or_less(values["left_to_right"])
        return f"the wheels turn {ratio} to the left than to the right"

    def _linked(self, servo: Tensor) -> Tensor:
        gain = self._value("left_to_right").clamp_min(1e-3).sqrt()
        return torch.where(servo > 0, servo * gain, servo / gain)


class SteeringCurve(LinkageMap):
    """A curved map of the steering to the same lock: exponential or saturating.

    Its slope is 1 - c about the centre and 1 + 2 c at full lock. With c > 0, as of the exponential
    setting of a radio, it is less sensitive in the middle; with c < 0, as of a servo horn that has
    turned far or of an arctangent, the last part of the command turns the wheels little.
    """

    name = "steering_curve"
    look_at = (
        "Check exponential (expo, dual rate) in radio or driver, and the angle of the servo horn."
    )
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

    def _linked(self, servo: Tensor) -> Tensor:
        return servo + self._value("curvature") * servo * (servo.square() - 1)


class SteeringEndStop(LinkageMap):
    """Wheels that stop before full lock, on one side or on both: a stop, or a part in the way.

    The servo goes on, and meets the stop at the speed that it has.
    """

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

    def _linked(self, servo: Tensor) -> Tensor:
        left, right = self._value("left_cut"), self._value("right_cut")
        # A side without a cut has no stop either: not even at full lock.
        stopped = torch.where(left > 0, torch.minimum(servo, 1 - left), servo)
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
