"""A drive that differs from the one asked for; drive = (throttle + 1) / 2 in 0..1.

Of a throttle with reverse, drive = throttle above 0; below 0 nothing is changed here.
"""

from abc import abstractmethod
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, LongitudinalCommand, command_of, drive_of
from buggy_rl.effects.actuation.command import FARTHEST, CommandEffect
from buggy_rl.effects.base import EffectParameter, more_or_less, numbers_spec

MINUTE = 60.0  # [s]


class DriveEffect(CommandEffect):
    """d' = f(d), not below 0; above 1 where the effect and the engine go on there."""

    channel = 0

    @abstractmethod
    def _acting_drive(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        """f, of drives [n]."""

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        drive = drive_of(command, self.rest)
        most = drive_of(FARTHEST, self.rest) if self.extends else 1.0
        acting = self._acting_drive(drive, tensordict).clamp(0.0, most)
        if self.rest != ONE_WAY_REST:
            return torch.where(command > 0, acting, command)
        return command_of(acting, self.rest)


class DriveGainEffect(DriveEffect):
    """d' = onset + g (d - onset) above the onset: a gain of the motor's force, not of the command.

    A simulated motor with a deadband gives no force below it; with another gain it starts at the
    same throttle. `measured_onset` finds the onset of a simulator. A gain above 1 is a motor or a
    battery that is stronger at full throttle too.
    """

    extends = True
    option_names = ("onset",)
    onset: float = 0.0
    """Drive in 0..1 at which the simulated motor begins to give force."""

    @abstractmethod
    def _gain_change(self, tensordict: TensorDictBase) -> Tensor:
        """Gain less 1, g - 1, of the active rows [n]."""

    def _acting_drive(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        return drive + self._gain_change(tensordict) * (drive - self.onset).clamp_min(0.0)


class ThrottleGain(DriveGainEffect):
    """Another gain of the drive: a motor or battery of other strength, or an end point.

    Of a speed command it is the calibration of the speed.
    """

    name = "throttle_gain"
    look_at = "Check the battery's voltage, the throttle's end point (EPA) and the gearing."
    equation = "drive' - onset = gain (drive - onset)"
    source = (
        "Lyons et al. 2024, DART, dart_dynamic_models.py (force in proportion to the throttle "
        "above its deadband)"
    )
    declared = (
        EffectParameter(
            "gain",
            1.0,
            0.1,
            4.0,
            "-",
            "Drive that acts over drive given.",
            size=0.2,
            probe=0.02,
            usual=(0.7, 1.3),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the motor is driven {more_or_less(values['gain'])} than the throttle says"

    @classmethod
    def sentence_for(cls, values: Mapping[str, float], command: LongitudinalCommand) -> str:
        ratio = values["gain"]
        if command.kind == "speed":
            faster = "faster" if ratio >= 1 else "slower"
            return f"the car drives {100 * abs(ratio - 1):.3g} % {faster} than commanded"
        if command.kind == "current":
            return f"the motor gets {more_or_less(ratio)} current than commanded"
        return cls.sentence(values)

    def _gain_change(self, tensordict: TensorDictBase) -> Tensor:
        return self._value("gain") - 1


class ThrottleOffset(CommandEffect):
    """A throttle channel whose zero is shifted, as by the trim of a radio."""

    name = "throttle_offset"
    look_at = "Check the throttle trim, and calibrate the speed controller's neutral point."
    channel = 0
    equation = "throttle' = throttle + offset"
    source = (
        "Astrom & Murray 2008, Feedback Systems, sec. 11.1 (constant load disturbance at the input "
        "of the process)"
    )
    declared = (
        EffectParameter(
            "offset",
            0.0,
            -1.0,
            1.0,
            "-",
            "Added to the throttle command.",
            size=0.1,
            probe=0.01,
            usual=(-0.2, 0.2),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        more = "more" if values["offset"] >= 0 else "less"
        return (
            f"the throttle acts as if it were {50 * abs(values['offset']):.3g} % of its range "
            f"{more} open"
        )

    @classmethod
    def sentence_for(cls, values: Mapping[str, float], command: LongitudinalCommand) -> str:
        share = 100 * abs(drive_of(values["offset"], command.rest) - drive_of(0.0, command.rest))
        side = "above" if values["offset"] >= 0 else "below"
        if command.kind == "speed":
            return f"the car aims {share:.3g} % of its full speed {side} the speed commanded"
        if command.kind == "current":
            return f"the motor's current is {share:.3g} % of a full one {side} the one commanded"
        return cls.sentence(values)

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        return command + self._value("offset")


class ThrottleDeadband(DriveEffect):
    """Dead zone: drive below the width does nothing; above, all, part or none of it is restored.

    Many speed controllers stretch the range above their deadband so that full throttle is full
    drive (restored = 1). With restored = 0 the deadband is an offset.
    """

    name = "throttle_deadband"
    look_at = (
        "Open the throttle slowly until the wheels turn; calibrate the speed controller's neutral."
    )
    equation = "drive' = max(0, drive - width) (1 + restored width / (1 - width))"
    source = (
        "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (dead zone); with restored = 0 the "
        "motor of Lyons et al. 2024, DART"
    )
    deciding = ("width",)
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            0.9,
            "-",
            "Drive in 0..1 below which the motor is off.",
            size=0.16,
            probe=0.01,
            usual=(0.0, 0.25),
        ),
        EffectParameter(
            "restored", 0.0, 0.0, 1.0, "-", "Share given back at full throttle.", 0.5, 0.05
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the first {100 * values['width']:.3g} % of the throttle do nothing"

    def _acting_drive(self, drive: Tensor, tensordict: TensorDictBase) -> Tensor:
        width, restored = self._value("width"), self._value("restored")
        return (drive - width).clamp_min(0.0) * (1 + restored * width / (1 - width))


class BatterySag(DriveGainEffect):
    """Discharge: the drive weakens as the battery empties, linear in time.

    Radio-control users call the drop under load sag: that is `voltage_sag`. The time is in the
    TensorDict: a reset or an edit may set `elapsed` [*, 1] s; after a reset without it, it is 0.
    Rollouts of recordings set it to the time since the first recording of the session.
    """

    name = "battery_sag"
    look_at = "Measure the battery's voltage under load at the start and at the end of a drive."
    equation = "drive' - onset = (1 - loss_per_minute elapsed / 60 s) (drive - onset)"
    source = (
        "Linden & Reddy 2002, Handbook of Batteries, 3rd ed., ch. 3 (voltage during discharge), "
        "linearised in time"
    )
    declared = (
        EffectParameter(
            "loss_per_minute",
            0.0,
            -0.5,
            1.0,
            "1/min",
            "Share of the drive that is lost each minute since the battery was charged.",
            size=0.06,
            probe=0.02,
            usual=(0.0, 0.15),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = 100 * values["loss_per_minute"]
        verb = "weakens" if loss >= 0 else "strengthens"
        return (
            f"the drive {verb} by {abs(loss):.3g} % a minute while the battery is discharged, "
            "from the first recording on"
        )

    def _gain_change(self, tensordict: TensorDictBase) -> Tensor:
        elapsed = self._gather(tensordict.get(keys.ELAPSED)).squeeze(-1)
        return -self._value("loss_per_minute") * elapsed / MINUTE

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        after.set(keys.ELAPSED, before.get(keys.ELAPSED) + self.dt)

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        pose, elapsed = state.get(keys.POSE), given.get(keys.ELAPSED, None)
        elapsed = torch.zeros_like(pose[..., :1]) if elapsed is None else elapsed.to(pose)
        state.set(keys.ELAPSED, elapsed.clone())

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {keys.ELAPSED: numbers_spec(shape, 1, device=device)}
