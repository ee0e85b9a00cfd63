"""Brakes that a simulator lacks, or that act at other wheels than simulated."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import drive_of
from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.delay import LAG_SOURCE, lag_decay
from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion, MotionEffect, along
from buggy_rl.effects.motion.drive import turning_drag
from buggy_rl.effects.motion.resistance import slowed
from buggy_rl.effects.motion.steered import left_by_tyres

IDLE = 0.01  # [-] drive beyond the dead zone at which the drag brake is off; chosen
ROLLS = 0.2  # [m/s] forward speed from which all of a command below 0 is brake; chosen
SLOWEST = 0.3  # [m/s] speed below which an arc is no tighter; chosen
USED = 0.95  # [-] largest share of its friction that a brake is taken to use; chosen


class DragBrake(MotionEffect):
    """A brake that is on while the command is within the dead zone: at most to a stop."""

    name = "drag_brake"
    look_at = "Check the drag brake that is set in the speed controller."
    equation = "dvx/dt = -deceleration sign(vx) without a command, at most to a stop"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 3 (constant retardation)"
    declared = (
        EffectParameter(
            "deceleration", 0.0, 0.0, 10.0, "m/s^2", "Without a command.", size=0.8, probe=0.1
        ),
    )
    option_names = ("onset", "reverse_onset")
    onset: float = 0.0
    """Drive in 0..1 at which the simulated motor begins to give force."""
    reverse_onset: float = 0.0
    """Command in 0..1 at which the simulated brake and reverse begin to give force."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["deceleration"]
        return f"without a command a brake takes {loss:.3g} m/s a second from the car"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        if motion.asked is None:  # without reverse there is no such brake
            return along(torch.zeros_like(vx))
        forward = (motion.asked - self.onset).clamp_min(0.0)
        backward = (-motion.asked - self.reverse_onset).clamp_min(0.0)
        idle = (1 - (forward + backward) / IDLE).clamp_min(0.0)
        loss = self._value("deceleration") * idle
        return along(slowed(vx, loss * self.dt))


class BrakeBalance(MotionEffect):
    """Part of the brake force at the other axle: X moves from the rear axle to the front one.

    X = shift B b, with B the deceleration of the simulated brakes at full command and b the
    command. At a road-wheel angle delta it adds -X (cos(delta) - 1) along, -X sin(delta) across
    and the moment of that. By the friction ellipse the side force of an axle with brake force x
    (over friction times load) changes by sqrt((1 - x'^2) / (1 - x^2)). What the tyres take back
    within the step is as in `yaw.YawEffect`, for both axles together.
    """

    name = "brake_balance"
    look_at = "Check which axle brakes how much: differentials, slipper clutch, a mechanical brake."
    equation = "front brake share' = front brake share + shift"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 3 (brake proportioning)"
    declared = (
        EffectParameter(
            "shift", 0.0, -1.0, 1.0, "-", "Added to the share of the brakes in front.", 0.3, 0.05
        ),
    )
    option_names = (
        "braking",
        "reverse_onset",
        "brake_front_share",
        "friction",
        "stiffness",
        "lock",
    )
    braking: float = 5.0
    """B [m/s^2]."""
    reverse_onset: float = 0.0
    """Drive in 0..1 at which the simulated brake begins."""
    brake_front_share: float = 0.0
    """Share of the simulated brakes at the front axle, 0..1."""
    friction: tuple[float, float] = (0.84, 0.84)
    """Friction of the simulated front and rear axle; DART."""
    stiffness: tuple[float, float] = (0.0, 0.0)
    """Cornering stiffness over load of both axles [1/rad]; 0 for a simulator without tyres."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share, to = 100 * abs(values["shift"]), "front" if values["shift"] >= 0 else "rear"
        return f"{share:.3g} % of the brake force acts at the {to} axle instead of the other"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        if motion.asked is None:
            return along(torch.zeros_like(vx))
        span = max(1 - self.reverse_onset, 1e-3)
        pressed = (-motion.asked - self.reverse_onset).clamp_min(0.0) / span
        force = self.braking * pressed * (vx / ROLLS).clamp(0.0, 1.0)
        share = self.brake_front_share + self._value("shift")
        moved = (share.clamp(0.0, 1.0) - self.brake_front_share) * force
        d = self.dimensions
        angle = d.wheelbase * motion.turn_rate / motion.rolling(SLOWEST)
        angle = angle.clamp(-self.lock, self.lock)
        front, rear = self._side_changes(motion, force, moved)
        front = front * torch.cos(angle) - moved * torch.sin(angle)
        front, rear = left_by_tyres(motion, d, self.stiffness, front, rear)
        moment = d.cg_to_front_axle * front - d.cg_to_rear_axle * rear
        yaw = d.mass / d.yaw_inertia * moment
        ahead = -moved * (torch.cos(angle) - 1)
        return self.dt * torch.stack([ahead, front + rear, yaw], -1)

    def _side_changes(self, motion: Motion, force: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
        """Change of both side forces [n] over mass, by the friction ellipse."""
        d = self.dimensions
        _, ay, yaw = motion.acceleration
        front = (d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * yaw) / d.wheelbase
        lift = d.cg_height / d.wheelbase * force
        load = GRAVITY * d.cg_to_rear_axle / d.wheelbase + lift
        behind = (GRAVITY * d.cg_to_front_axle / d.wheelbase - lift).clamp_min(0.1 * GRAVITY)
        own = self.brake_front_share * force
        sides = (front, self.friction[0] * load, own, own + moved)
        rest = force - own
        return _scaled(*sides), _scaled(ay - front, self.friction[1] * behind, rest, rest - moved)


def _scaled(side: Tensor, circle: Tensor, brake: Tensor, changed: Tensor) -> Tensor:
    """Change of a side force [n] by another brake force [n] of its axle, all over mass."""
    before, after = (1 - (x / circle).clamp(0.0, USED).square() for x in (brake, changed))
    return side * ((after / before).sqrt() - 1)


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
