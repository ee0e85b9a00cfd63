"""Commands that act with a dead time or a first-order lag.

An engine holds one command for a whole control period. What acts within the period is not
constant, so the engine gets its mean over the period.
"""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.delay import (
    LAG_SOURCE,
    DeadTimeEffect,
    dead_time,
    lag_decay,
    time_constant,
)


class DeadTime(DeadTimeEffect, RememberingCommand):
    """A dead time that need not be a whole number of periods.

    The commands are a staircase; with a dead time of n + s periods its mean over a period is
    (1 - s) u_{k-n} + s u_{k-n-1}.
    """

    equation = "u'(t) = u(t - dead_time)"
    subject: ClassVar[str]
    """What the command moves, in words."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the {cls.subject} takes effect {1000 * values['dead_time']:.3g} ms late"

    @property
    def size(self) -> int:
        return self._rows_back

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        rows = torch.cat([command.unsqueeze(-1), state], -1)  # (n, K + 1), newest first
        index = self._tensor("whole").expand(command.shape).unsqueeze(-1)
        newer = rows.gather(-1, index).squeeze(-1)
        older = rows.gather(-1, index + 1).squeeze(-1)
        return newer + self._tensor("share") * (older - newer), rows[..., :-1]


class Lag(RememberingCommand):
    """A first-order lag, solved exactly for a command that is constant over a period.

    y_{k+1} = u + (y_k - u) e,  e = exp(-dt / T), and its mean over the period is
    u + (y_k - u) (1 - e) T / dt.
    """

    equation = "time_constant du'/dt = u - u'"
    source = LAG_SOURCE
    lasting = True
    response: ClassVar[str]
    """What the lag does, in words."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"{cls.response} gradually: 63 % of a change is there after {lag:.3g} ms"

    def _values_changed(self) -> None:
        end, mean = lag_decay(self._value("time_constant"), self.dt)
        self._store(decay=end, mean_decay=mean)

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        behind = state.squeeze(-1) - command
        end = command + behind * self._tensor("decay")
        return command + behind * self._tensor("mean_decay"), end.unsqueeze(-1)


class ThrottleDeadTime(DeadTime):
    """The throttle acts with a dead time."""

    name = "throttle_dead_time"
    look_at = (
        "Look for delays between command and motor: radio, message queues, controller firmware."
    )
    declared = dead_time(0.05, (0.0, 0.15))
    channel = 0
    subject = "throttle"


class SteeringDeadTime(DeadTime):
    """The steering acts with a dead time."""

    name = "steering_dead_time"
    look_at = (
        "Look for delays between command and servo: radio, message queues, the PWM update rate."
    )
    declared = dead_time(0.10, (0.0, 0.2))
    channel = 1
    subject = "steering"


class ThrottleLag(Lag):
    """The throttle acts through a first-order lag."""

    name = "throttle_lag"
    look_at = "Check the speed controller's ramp (soft start, punch) and filters on the command."
    declared = time_constant(0.10, (0.0, 0.25))
    channel = 0
    response = "the throttle builds up"


class SteeringLag(Lag):
    """The steering acts through a first-order lag."""

    name = "steering_lag"
    look_at = "Check the servo: torque, supply voltage, servo saver; and filters on the command."
    declared = time_constant(0.13, (0.0, 0.2))
    channel = 1
    response = "the wheels turn"
