"""Brake and reverse side of a two-way speed controller (ESC): u < 0 of a throttle with reverse."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.base import EffectParameter, more_or_less
from buggy_rl.longitudinal import ONE_WAY_REST

ROLLS = 0.2  # [m/s] forward speed from which all of a command below 0 is brake; chosen


class BrakeEffect(CommandEffect):
    """u' = f(u) where u < 0; a throttle without reverse is left as it is."""

    channel = 0

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        if self.rest == ONE_WAY_REST:
            return command
        return torch.where(command < 0, -self._pressed(-command, tensordict), command)

    def _pressed(self, asked: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Brake or reverse that acts [n], 0..1, instead of the one asked for [n]."""
        raise NotImplementedError


class BrakeGain(BrakeEffect):
    """Another gain of the brakes, up to full brake; reverse, which begins at rest, keeps its own.

    Above the onset of the simulated brake b' = onset + g (b - onset), of which the share
    min(vx / 0.2 m/s, 1) acts.
    """

    name = "brake_gain"
    look_at = (
        "Check the brake strength that is set in the speed controller, and the radio's "
        "brake end point."
    )
    equation = "brake' - onset = gain (brake - onset) while the car rolls forward"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 3 (brake gain)"
    declared = (
        EffectParameter(
            "gain",
            1.0,
            0.1,
            4.0,
            "-",
            "Brake that acts over brake given.",
            size=0.3,
            probe=-0.05,
            usual=(0.5, 1.5),
        ),
    )
    option_names = ("reverse_onset",)
    reverse_onset: float = 0.0
    """Drive in 0..1 at which the simulated brake begins."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the brakes take {more_or_less(values['gain'])} than the command says"

    def _pressed(self, asked: Tensor, tensordict: TensorDictBase) -> Tensor:
        vx = self._gather(tensordict.get(keys.VELOCITY))[..., 0]
        above = (asked - self.reverse_onset).clamp_min(0.0) * (vx / ROLLS).clamp(0.0, 1.0)
        return asked + (self._value("gain") - 1) * above


class ReverseDeadband(BrakeEffect):
    """Dead zone of brake and reverse; above it all, part or none of the range is restored."""

    name = "reverse_deadband"
    look_at = "Calibrate the speed controller's neutral and full-reverse points."
    equation = "brake' = max(0, brake - width) (1 + restored width / (1 - width))"
    source = "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (dead zone)"
    deciding = ("width",)
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            0.9,
            "-",
            "Brake in 0..1 below which nothing acts.",
            size=0.1,
            probe=0.01,
            usual=(0.0, 0.2),
        ),
        EffectParameter(
            "restored", 0.0, 0.0, 1.0, "-", "Share given back at full brake.", 0.5, 0.05
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the first {100 * values['width']:.3g} % of brake and reverse do nothing"

    def _pressed(self, asked: Tensor, tensordict: TensorDictBase) -> Tensor:
        width, restored = self._value("width"), self._value("restored")
        return (asked - width).clamp_min(0.0) * (1 + restored * width / (1 - width))
