"""What a speed controller makes of its setpoint: a ramp, a least speed, an integral of the error.

The simulated controller gives an acceleration speed_gain (v_set - v); to have another one's, it
gets another setpoint. `measuring` finds its gain and the setpoint of a full command.
"""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.actuation.command import (
    GIVEN,
    STANDING,
    CommandEffect,
    RememberingCommand,
)
from buggy_rl.effects.base import EffectParameter, numbers_spec
from buggy_rl.effects.motion.base import SETTING_OFF
from buggy_rl.longitudinal import ONE_WAY_REST, command_of, drive_of

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
    """Below the least speed that it controls, the controller lets the car roll; above, all acts.

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
    """Of the simulated controller: acceleration over the speed that is missing [1/s]."""
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
