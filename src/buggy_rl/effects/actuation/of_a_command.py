"""Brake and reverse side of a two-way speed controller (ESC): u < 0 of a throttle with reverse."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, command_of, drive_of
from buggy_rl.effects.actuation.command import (
    GIVEN,
    STANDING,
    CommandEffect,
    RememberingCommand,
)
from buggy_rl.effects.base import EffectParameter, more_or_less, numbers_spec
from buggy_rl.effects.motion.base import SETTING_OFF

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


VESC = "VESC firmware, bldc (Vedder 2015 ff.), speed PID"
NO_RAMP = 1e6  # [m/s^2] neutral ramp: any setpoint within 5 us, faster than any command
EDGE = 0.05  # [m/s] of setpoints over which the controller lets go below the least one; chosen
WOUND = 3.0  # [m/s^2] largest acceleration by the integral: full pull of a 1:10 car; chosen
HELD = 3.0  # [s] for which a car that is set down in motion is taken to have held its speed; chosen


class SpeedRamp(RememberingCommand):
    """The setpoint follows its command no faster than a ramp, up and down alike."""

    name = "speed_ramp"
    look_at = "Read the controller's ramp or acceleration limit of the speed command."
    channel = 0
    lasting = True
    equation = "|dv_set/dt| <= acceleration"
    source = f"{VESC} (ramp of the setpoint, 25000 ERPM/s as shipped)"
    declared = (
        EffectParameter(
            "acceleration",
            NO_RAMP,
            0.2,
            NO_RAMP,
            "m/s^2",
            "Fastest change of the setpoint.",
            size=5.0,
            probe=5.0 - NO_RAMP,
            reciprocal=True,
            usual=(1.0, 15.0),
        ),
    )
    option_names = ("full_speed",)
    full_speed: float = 5.0
    """Setpoint of a full command [m/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ramp = values["acceleration"]
        return f"the speed controller changes its setpoint by {ramp:.3g} m/s a second at most"

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        start = state.squeeze(-1)
        span = 2.0 if self.rest == ONE_WAY_REST else 1.0  # of commands from 0 to full speed
        reach = (self._value("acceleration") * (self.dt * span / self.full_speed)).clamp_min(1e-9)
        moved = torch.minimum(torch.maximum(command - start, -reach), reach)
        # Of a setpoint that arrives within the period, the mean over the period.
        return start + moved - 0.5 * moved * moved.abs() / reach, (start + moved).unsqueeze(-1)


class LeastSpeed(CommandEffect):
    """Least speed that the controller controls: below, it lets the car roll; above, all acts.

    A sensorless motor cannot be controlled at a crawl. Unlike a dead band it takes nothing from the
    setpoints above: at the least speed the command jumps.
    """

    name = "least_speed"
    look_at = "Read the controller's least speed (ERPM) and its start-up setting."
    channel = 0
    equation = "no force where |v_set| < speed"
    source = f"{VESC} (minimum ERPM, 900 as shipped)"
    declared = (
        EffectParameter(
            "speed",
            0.0,
            0.0,
            5.0,
            "m/s",
            "Least setpoint at which the controller acts.",
            size=0.4,
            probe=0.1,
            usual=(0.0, 0.6),
        ),
    )
    option_names = ("full_speed",)
    full_speed: float = 5.0
    """Setpoint of a full command [m/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"the speed controller does nothing for commands below {values['speed']:.3g} m/s: the "
            "car stands or rolls, and from there on all of the command acts"
        )

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        setpoint = self.full_speed * drive_of(command, self.rest)
        below = ((self._value("speed") - setpoint.abs()) / EDGE).clamp(0.0, 1.0)
        vx = self._gather(tensordict.get(keys.VELOCITY))[..., 0]
        # A controller whose setpoint is the car's own speed gives no force.
        rolling = command_of(vx / self.full_speed, self.rest)
        return command + below * (rolling - command)


class SpeedIntegral(CommandEffect):
    """Integral action: the setpoint is reached whatever the resistance, with some overshoot.

    v_set' = v_set + I, dI/dt = rate (v_set - v), with |I| at most what gives 3 m/s^2. Of a car that
    is set down in motion, I is that of a speed held for 3 s.
    """

    name = "speed_integral"
    look_at = "Read the integral gain of the speed controller's PID."
    channel = 0
    extends = True
    equation = "a = speed_gain (v_set - v + rate integral of (v_set - v))"
    source = "Astrom & Murray 2008, Feedback Systems, sec. 10.1 (integral action)"
    declared = (
        EffectParameter(
            "rate",
            0.0,
            0.0,
            20.0,
            "1/s",
            "Integral gain over the proportional one.",
            size=1.0,
            probe=0.2,
            usual=(0.0, 5.0),
        ),
    )
    option_names = ("coasting", "speed_gain", "full_speed")
    coasting: tuple[float, float] = (0.5, 0.25)
    """c0 [m/s^2] and c1 [1/s] of the simulated car without a force of the motor."""
    speed_gain: float = 10.0
    """Gain of the simulated controller: acceleration over the speed that is missing [1/s]."""
    full_speed: float = 5.0
    """Setpoint of a full command [m/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            "the speed controller has integral action: what is missing to the setpoint is made up "
            f"with a time constant of {1 / max(values['rate'], 1e-3):.3g} s"
        )

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        rate = self._value("rate").clamp_min(0.0)
        vx = self._gather(tensordict.get(keys.VELOCITY))[..., 0]
        setpoint = self.full_speed * drive_of(command, self.rest)
        memory = tensordict.get(self.memory)  # (*, 2): I, and 1 until it is known
        held, unknown = self._gather(memory).unbind(-1)
        loss = self.coasting[0] * torch.tanh(vx / SETTING_OFF) + self.coasting[1] * vx
        settled = -torch.expm1(-rate * HELD) * loss / self.speed_gain
        before = torch.where(unknown > 0.5, settled, held)
        most = WOUND / self.speed_gain
        after = (before + self.dt * rate * (setpoint - vx)).clamp(-most, most)
        rows = torch.stack([after, torch.zeros_like(after)], -1)
        tensordict.set(self.memory + GIVEN, self._scatter(memory, rows))
        return command_of((setpoint + 0.5 * (before + after)) / self.full_speed, self.rest)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        after.set(self.memory, before.get(self.memory + GIVEN))

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        velocity = state.get(keys.VELOCITY)
        moving = torch.linalg.vector_norm(velocity[..., :2], dim=-1) > STANDING
        known = torch.zeros_like(velocity[..., 0])
        state.set(self.memory, torch.stack([known, moving.to(velocity)], -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, 2, device=device)}
