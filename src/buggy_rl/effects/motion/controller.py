"""A speed controller that is slower than simulated, or that sees the axle and not the car.

The controller's part of the acceleration of a black box is that acceleration plus the deceleration
of the car without a force of the motor, as in `drive`, of either sign.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.delay import LAG_SOURCE, lag_decay
from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion, MotionEffect, along
from buggy_rl.effects.motion.drive import turning_drag
from buggy_rl.longitudinal import drive_of

UNSURE_BY = 0.5  # [m/s^2] by which an acceleration may be off: a tenth of full pull; chosen
UNSURE = 0.15  # [-] likewise, in proportion: a gain measured over 10 ms is 8 % low; chosen


class ControllerEffect(MotionEffect):
    """The controller's acceleration, replaced by that of another controller."""

    option_names = ("coasting", "lock")
    coasting: tuple[float, float] = (0.5, 0.25)
    """c0 [m/s^2] and c1 [1/s] of the simulated car without a force of the motor."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    def _controlled(self, motion: Motion) -> Tensor:
        """Acceleration [n] [m/s^2] by the controller, of either sign."""
        ax, _, _ = motion.acceleration
        vx = 0.5 * (motion.before[..., 0] + motion.after[..., 0])
        loss = self.coasting[0] * torch.tanh(vx / SETTING_OFF) + self.coasting[1] * vx
        return ax + loss + turning_drag(motion, self.dimensions, self.lock)


class SpeedControllerLag(ControllerEffect):
    """The force of a speed controller follows what it wants with a first-order lag.

    Its loop has a second pole then: it overshoots where the setpoint's own lag would not.
    """

    name = "speed_controller_lag"
    look_at = "Check the gains and the acceleration limit of the speed controller."
    equation = "time_constant dF/dt = K (v_set - v) - F"
    source = LAG_SOURCE
    declared = (
        EffectParameter(
            "time_constant",
            0.0,
            0.0,
            1.0,
            "s",
            "Time to 63 % of a step.",
            size=0.08,
            probe=0.01,
            usual=(0.0, 0.2),
        ),
    )
    state_size = 2  # the force over mass [m/s^2], and 1 once it is known

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"the speed controller's force builds up: 63 % of it is there after {lag:.3g} ms"

    def _change(self, motion: Motion) -> Tensor:
        return self._change_and_state(motion)[0]

    def _change_and_state(self, motion: Motion) -> tuple[Tensor, Tensor]:
        assert motion.state is not None
        wanted, (held, known) = self._controlled(motion), motion.state.unbind(-1)
        behind = torch.where(known > 0.5, held - wanted, torch.zeros_like(wanted))
        end, mean = lag_decay(self._value("time_constant"), self.dt)
        state = torch.stack([wanted + behind * end, torch.ones_like(wanted)], -1)
        return along(self.dt * behind * mean), state


class DrivenAxleSlip(ControllerEffect):
    """The setpoint is reached by the driven axle, which slips: the car is slower by the slip.

    v_axle = vx + |vx| s a_t, with a slip s for each m/s^2 of the tyres' acceleration a_t: that of
    the car, plus the resistance at its body and its turned wheels, without what motor and gear
    lose. So the controller's acceleration falls by w / (1 + w) a_t, w = k |vx| s. Where it was at
    a limit, wanting more than it gave, it falls by so much less.
    """

    name = "driven_axle_slip"
    look_at = (
        "Check the driven tyres, their diameter in the speed controller, and the slipper clutch."
    )
    equation = "a = speed_gain (v_set - vx - |vx| slip_per_acceleration a)"
    source = "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., sec. 4.1.2 (slip ratio)"
    declared = (
        EffectParameter(
            "slip_per_acceleration",
            0.0,
            0.0,
            0.3,
            "s^2/m",
            "Slip ratio of the driven tyres over the acceleration that they give.",
            size=0.015,
            probe=0.003,
            usual=(0.0, 0.05),
        ),
    )
    option_names = ("coasting", "lock", "resistance", "speed_gain", "full_speed")
    resistance: tuple[float, float] = (0.0, 0.0)
    """r0 [m/s^2] and r1 [1/s] of the resistance at the body, which the driven tyres carry."""
    speed_gain: float = 10.0
    """k of the simulated controller: acceleration over the speed that is missing [1/s]."""
    full_speed: float = 5.0
    """Setpoint of a full command [m/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        slip = 100 * values["slip_per_acceleration"]
        return (
            f"the speed controller holds the wheels' speed: they slip {slip:.3g} % for each "
            "m/s^2 of acceleration"
        )

    def _change(self, motion: Motion) -> Tensor:
        vx = 0.5 * (motion.before[..., 0] + motion.after[..., 0])
        slip = self._value("slip_per_acceleration").clamp_min(0.0)
        weight = self.speed_gain * vx.abs() * slip
        body = self.resistance[0] * torch.tanh(vx / SETTING_OFF) + self.resistance[1] * vx
        ax, _, _ = motion.acceleration
        pulled = ax + body + turning_drag(motion, self.dimensions, self.lock)
        less = weight / (1 + weight) * pulled
        return along(-self.dt * slowed_by(less, self._held_back(motion, vx)))

    def _held_back(self, motion: Motion, vx: Tensor) -> Tensor:
        """What is wanted beyond what is given [n] [m/s^2], but for the errors of both."""
        given = self._controlled(motion)
        command = motion.action[..., 0] if motion.asked is None else motion.asked
        wanted = self.speed_gain * (self.full_speed * drive_of(command, self.rest) - vx)
        return (wanted.abs() - (1 + UNSURE) * given.abs() - UNSURE_BY).clamp_min(0.0)


def slowed_by(change: Tensor, held: Tensor) -> Tensor:
    """A change [n] made smaller by `held` [n] >= 0, not beyond 0."""
    return torch.sign(change) * (change.abs() - held).clamp_min(0.0)
