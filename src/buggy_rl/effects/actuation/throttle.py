"""A drive that differs from the one asked for; drive = (throttle + 1) / 2 in 0..1."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.actuation.command import CommandEffect
from buggy_rl.effects.base import EffectParameter, numbers_spec, one_in

MINUTE = 60.0  # [s]


class DriveEffect(CommandEffect):
    """d' = f(d), kept within 0..1: no simulator is asked for more than full drive."""

    channel = 0

    @abstractmethod
    def _driven(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        """f, of drives [n]."""

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return 2 * self._driven(0.5 * (command + 1), tensordict).clamp(0.0, 1.0) - 1


class PullEffect(DriveEffect):
    """d' = onset + g (d - onset) where the motor pulls: a factor of the pull, not of the command.

    A simulated motor with a deadband does nothing below it, and a weaker one still sets off at the
    same throttle. `measured_onset` finds the onset for a simulator.

    Args:
        onset: Drive in 0..1 at which the simulated motor begins to pull.
        dt, values: As for the other effects.
    """

    def __init__(self, *, onset: float = 0.0, **rest: Any) -> None:
        self.onset = float(onset)
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        return super().options | ({"onset": self.onset} if self.onset else {})

    @abstractmethod
    def _more(self, tensordict: TensorDictBase) -> Tensor:
        """The change g - 1 of the cars that feel the effect."""

    def _driven(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        return drive + self._more(tensordict) * (drive - self.onset).clamp_min(0.0)


class ThrottleGain(PullEffect):
    """More or less drive than asked for, up to full drive."""

    name = "throttle_gain"
    equation = "drive' - onset = gain (drive - onset)"
    declared = (
        EffectParameter("gain", 1.0, 0.1, 4.0, "-", "Drive that acts over drive asked.", 0.2, 0.02),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the motor is driven {one_in(values['gain'])} than the throttle says"

    def _more(self, tensordict: TensorDictBase) -> Tensor:
        return self._here("gain") - 1


class ThrottleOffset(CommandEffect):
    """A throttle channel whose zero has shifted."""

    name = "throttle_offset"
    channel = 0
    equation = "throttle' = throttle + offset"
    declared = (
        EffectParameter("offset", 0.0, -1.0, 1.0, "-", "Added to the throttle command.", 0.1, 0.01),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        more = "more" if values["offset"] >= 0 else "less"
        return (
            f"the throttle acts as if it were {50 * abs(values['offset']):.3g} % of its range "
            f"{more} open"
        )

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return command + self._here("offset")


class ThrottleDeadband(DriveEffect):
    """The first part of the drive does nothing, and is missing from the rest, or not quite.

    Many speed controllers stretch what lies beyond their deadband so that full throttle is full
    drive all the same (restored = 1); where nothing is restored, a deadband is an offset.
    """

    name = "throttle_deadband"
    equation = "drive' = max(0, drive - width) (1 + restored width / (1 - width))"
    source = "DART, Lyons et al., whose motor acts on the drive less a deadband: restored = 0"
    deciding = ("width",)
    declared = (
        EffectParameter(
            "width", 0.0, 0.0, 0.9, "-", "Drive in 0..1 below which the motor is off.", 0.08, 0.01
        ),
        EffectParameter(
            "restored", 0.0, 0.0, 1.0, "-", "Share given back at full throttle.", 0.5, 0.05
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the first {100 * values['width']:.3g} % of the throttle do nothing"

    def _driven(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        width, restored = self._here("width"), self._here("restored")
        return (drive - width).clamp_min(0.0) * (1 + restored * width / (1 - width))


class BatterySag(PullEffect):
    """The drive weakens as the battery empties, by a clock that rides in the TensorDict.

    A reset or an edit may set `elapsed` [*, 1] s; it is 0 at a reset that does not.
    """

    name = "battery_sag"
    equation = "drive' - onset = (1 - loss_per_minute elapsed / 60 s) (drive - onset)"
    declared = (
        EffectParameter(
            "loss_per_minute",
            0.0,
            -0.5,
            1.0,
            "1/min",
            "Share of the drive that is lost each minute of driving.",
            size=0.15,
            probe=0.02,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = 100 * values["loss_per_minute"]
        verb = "weakens" if loss >= 0 else "strengthens"
        return f"the drive {verb} by {abs(loss):.3g} % a minute as the battery empties"

    def _more(self, tensordict: TensorDictBase) -> Tensor:
        elapsed = self._take(tensordict.get(keys.ELAPSED)).squeeze(-1)
        return -self._here("loss_per_minute") * elapsed / MINUTE

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        return next_tensordict.set(keys.ELAPSED, tensordict.get(keys.ELAPSED) + self.dt)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if not self.active:
            return tensordict_reset
        pose = tensordict_reset.get(keys.POSE)
        given = tensordict.get(keys.ELAPSED, None)
        elapsed = torch.zeros_like(pose[..., :1]) if given is None else given.to(pose)
        return tensordict_reset.set(keys.ELAPSED, elapsed.clone())

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {keys.ELAPSED: numbers_spec(shape, 1, device=device)}
