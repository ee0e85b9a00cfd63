"""Limits of the steering servo: its speed, its friction, and play in the linkage behind it."""

import math
from abc import abstractmethod
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.base import EffectParameter

LOADED = 0.5  # [m/s^2] lateral acceleration at which play is taken up to tanh(1) = 76 %; chosen
NO_LIMIT = 1e6  # [1/s] neutral rate: the whole range of 2 in 2 us, faster than any command


class ServoEffect(RememberingCommand):
    """Road wheels at r_k = f(r_{k-1}, u_k) in command units, instead of where the simulator's are.

    The simulator's own servo follows its command with a first-order lag,
    s_k = s_{k-1} + a (u_k - s_{k-1}), a = 1 - exp(-dt / lag). To have it at r_k the engine gets

    u'_k = r_{k-1} + (r_k - r_{k-1}) / a.

    `measured_steering_lag` finds the lag of a simulator. Without one, a = 1 and u'_k = r_k.
    """

    channel = 1
    lasting = True
    option_names = ("lag",)
    lag: float = 0.0
    """Time constant of the simulator's servo [s]."""

    @property
    def follows(self) -> float:
        """a, the share of its error that the simulator's servo corrects in a period."""
        return -math.expm1(-self.dt / self.lag) if self.lag > 0 else 1.0

    def _command_between(self, before: Tensor, after: Tensor) -> Tensor:
        """Command [n] that moves the simulator's servo from r_{k-1} to r_k."""
        return before + (after - before) / self.follows


class LinkageMap(ServoEffect):
    """Road wheels where a map takes them from where the servo is: r_k = f(s_k).

    The wheels may turn beyond what is full lock in the simulator.
    """

    extends = True

    @abstractmethod
    def _linked(self, servo: Tensor) -> Tensor:
        """Place [n] of the wheels, in command units, for one of the servo [n]."""

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        before = state.squeeze(-1)
        servo = before + self.follows * (command - before)
        # In differences, so that no map is no change to the last bit.
        held, hold = self._linked(before) - before, self._linked(servo) - servo
        return command + held + (hold - held) / self.follows, servo.unsqueeze(-1)


class SteeringRateLimit(ServoEffect):
    """Rate limit: r moves by m = min(max(a (u - r), -rate dt), rate dt) in a period.

    Without a lag the engine follows at once; it gets the mean over the period then,
    r + m - m |m| / (2 rate dt).
    """

    name = "steering_rate_limit"
    look_at = (
        "Check the servo: its rated speed, its supply voltage, and how freely the linkage moves."
    )
    equation = "|du'/dt| <= rate"
    source = "Stein 2003, Respect the Unstable, IEEE Control Systems Magazine 23(4) (rate limit)"
    declared = (
        EffectParameter(
            "rate",
            NO_LIMIT,
            0.2,
            NO_LIMIT,
            "1/s",
            "Fastest change of the steering command, of which the whole range is 2.",
            size=7.0,
            probe=6.0 - NO_LIMIT,
            reciprocal=True,
            usual=(3.0, 20.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the steering needs {2000 / values['rate']:.3g} ms from full right to full left"

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        start = state.squeeze(-1)
        reach = (self._value("rate") * self.dt).clamp_min(1e-9)
        change = self.follows * (command - start)
        moved = torch.minimum(torch.maximum(change, -reach), reach)
        if self.lag > 0:
            acting = torch.where(
                moved == change, command, self._command_between(start, start + moved)
            )
        else:
            # It moves for the share |moved| / reach of the period, on average at half the change.
            acting = start + moved - 0.5 * moved * moved.abs() / reach
        return acting, (start + moved).unsqueeze(-1)


class SteeringBacklash(ServoEffect):
    """Play: the linkage moves only after the servo has gone through the play.

    Without a load on the wheels, which rest where they are. At speed the tyres' aligning torque
    pushes them to one side of the play: that is `steering_play`.

    r_k = min(max(r_{k-1}, s_k - w / 2), s_k + w / 2), w the full width from stop to stop.
    """

    name = "steering_backlash"
    look_at = (
        "Hold the servo and move the front wheels by hand: play in horn, linkage, servo saver."
    )
    equation = "|servo - steering'| <= width / 2, and steering' rests while it can"
    source = "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (backlash)"
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            1.0,
            "-",
            "Play from stop to stop, of a range of 2.",
            size=0.1,
            probe=0.02,
            usual=(0.0, 0.25),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 50 * values["width"]
        return f"the steering has {share:.3g} % of its range as play when it turns back"

    @property
    def size(self) -> int:
        return 2  # servo, linkage

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        half = 0.5 * self._value("width").clamp_min(0.0)
        before, linkage = state.unbind(-1)
        servo = before + self.follows * (command - before)
        moved = torch.minimum(torch.maximum(linkage, servo - half), servo + half)
        acting = torch.where(half > 0, self._command_between(linkage, moved), command)
        return acting, torch.stack([servo, moved], -1)


class ServoStiction(ServoEffect):
    """A servo that rests until its command is off by more than a width, and then goes all the way.

    It goes on until the error is under a tenth of the width: m_k = max(rise(e_k), min(2 m_{k-1}, 1)
    fade(e_k)) of the error e is how far it moves, and r_k = r_{k-1} + m_k a (u_k - r_{k-1}). The
    rise from 0 to 1 over a quarter of the width, and the fade below a fifth, are for gradients.
    """

    name = "servo_stiction"
    look_at = (
        "Turn the wheels slowly by command: does the servo stick? Check dead band and linkage."
    )
    equation = "steering' rests while |steering - steering'| <= width, then goes to it"
    source = (
        "Armstrong-Helouvry, Dupont & Canudas de Wit 1994, Automatica 30(7) (stick-slip); the dead "
        "band that a servo's data sheet states"
    )
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            1.0,
            "-",
            "Command by which the servo must be off before it moves.",
            size=0.08,
            probe=0.03,
            usual=(0.0, 0.15),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 100 * values["width"]
        return f"the steering servo sticks until it is off by {share:.3g} % of the way to lock"

    @property
    def size(self) -> int:
        return 2  # servo, and how far it moves, 0..1

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        width = self._value("width").clamp_min(1e-6)
        servo, moving = state[..., 0], state[..., 1]
        error = (command - servo).abs() / width
        rise = (4 * error - 3.5).clamp(0.0, 1.0)
        # After a reset in motion the memory holds the command: the servo is there, and rests.
        going = (2 * moving).clamp(0.0, 1.0) * (10 * error - 1).clamp(0.0, 1.0)
        moving = torch.maximum(rise, going)
        moved = servo + moving * self.follows * (command - servo)
        return self._command_between(servo, moved), torch.stack([moved, moving], -1)


class SteeringPlay(ServoEffect):
    """Play under load: the tyres' aligning torque holds the wheels at one side of the play.

    The torque turns the wheels out of the bend, so in a bend half of the play is missing, and a bit
    of lateral acceleration decides to which side it is: r = s - (w / 2) tanh(vx r / 0.5 m/s^2).
    """

    lasting = False

    name = "steering_play"
    look_at = "Wiggle the front wheels by hand: ball joints, servo saver, hinge pins."
    equation = "steering' = steering - width / 2 tanh(vx r / 0.5 m/s^2)"
    source = (
        "Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 1.2 (aligning torque), on a "
        "linkage with play"
    )
    declared = (
        EffectParameter(
            "width",
            0.0,
            0.0,
            1.0,
            "-",
            "Play from stop to stop, of a range of 2.",
            size=0.1,
            probe=0.02,
            usual=(0.0, 0.25),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 50 * values["width"]
        return (
            f"the tyres push the wheels out of the bend by {share:.3g} % of the steering, as far "
            "as the linkage has play"
        )

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        vx, _, yaw_rate = self._gather(tensordict.get(keys.VELOCITY)).unbind(-1)
        pushed = torch.tanh(vx * yaw_rate / LOADED)
        off = (-0.5 * self._value("width").clamp_min(0.0) * pushed).unsqueeze(-1)
        before, unknown = self._recalled(tensordict)
        before = torch.where(unknown, off, before)
        self._keep(tensordict, off)
        return command + (before + (off - before) / self.follows).squeeze(-1)

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return command, torch.zeros_like(state)  # standing still, nothing pushes
