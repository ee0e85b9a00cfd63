"""A linkage that turns the wheels otherwise than it is told."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.base import EffectParameter, one_in


class SteeringGain(CommandEffect):
    """The wheels turn further, or less far, than told, up to full lock."""

    name = "steering_gain"
    channel = 1
    equation = "steering' = gain steering"
    declared = (
        EffectParameter(
            "gain", 1.0, 0.1, 4.0, "-", "Steering that acts over steering asked.", 0.15, 0.02
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the wheels turn {one_in(values['gain'])} than the steering says"

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return self._here("gain") * command


class SteeringOffset(CommandEffect):
    """Wheels that are not straight when told so."""

    name = "steering_offset"
    channel = 1
    equation = "steering' = steering + offset"
    declared = (
        EffectParameter(
            "offset", 0.0, -0.8, 0.8, "-", "Added to the steering command.", 0.06, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        side = "left" if values["offset"] >= 0 else "right"
        share = 100 * abs(values["offset"])
        return f"the car pulls to the {side}, as if steered by {share:.3g} % of full lock"

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return command + self._here("offset")


class SteeringAsymmetry(CommandEffect):
    """More steering to one side than to the other.

    Left times sqrt(q), right over sqrt(q), up to full lock: what they have in common is a gain.
    """

    name = "steering_asymmetry"
    channel = 1
    equation = "steering' = sqrt(q) steering to the left, steering / sqrt(q) to the right"
    declared = (
        EffectParameter(
            "left_to_right", 1.0, 0.2, 5.0, "-", "Gain to the left over gain right.", 0.2, 0.02
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the wheels turn {one_in(values['left_to_right'])} to the left than to the right"

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        gain = self._here("left_to_right").clamp_min(1e-3).sqrt()
        return torch.where(command > 0, command * gain, command / gain)
