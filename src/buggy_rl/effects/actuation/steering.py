"""A linkage with another static map from command to road-wheel angle."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.base import EffectParameter, more_or_less

STEERING_MAP = "Lyons et al. 2024, DART, dart_dynamic_models.py"


class LinkageEffect(CommandEffect):
    """A map behind the servo: the wheels may turn beyond what is full lock in the simulator."""

    channel = 1
    extends = True


class SteeringGain(LinkageEffect):
    """Another gain of the steering; beyond full lock where the engine goes on there."""

    name = "steering_gain"
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


class SteeringOffset(LinkageEffect):
    """Road wheels that are not straight at zero command."""

    name = "steering_offset"
    look_at = "Check the steering trim and that the servo horn is centred when the command is 0."
    equation = "steering' = steering + offset"
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


class SteeringAsymmetry(LinkageEffect):
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

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        gain = self._value("left_to_right").clamp_min(1e-3).sqrt()
        return torch.where(command > 0, command * gain, command / gain)
