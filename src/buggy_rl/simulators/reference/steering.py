"""Steering from the command to the directions of the front wheels: servo and linkage."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.state import GIVES, RACK, SERVO_MOVES, SET_POINT, STICKS
from buggy_rl.simulators.reference.tyres import sides

ATTACK = 0.15  # [-] share of a lag's time constant that its faster pole has; chosen
SHORTEST = 1e-6  # [s] stands for no lag, where the formula divides by the time constant


class Radio:
    """Throttle and steering with trims and dead times.

    A command k periods old holds over [-k dt, -k dt + dt]. With a dead time tau, the command of a
    substep is the mean over its own time less tau: exact, and continuous in tau.

    Args:
        faults: Trims and dead times.
        dt: Control period [s].
        substeps: In a control period.
    """

    def __init__(self, faults: Faults, dt: float, substeps: int) -> None:
        self.trimmed = "throttle_offset" in faults or "steering_offset" in faults
        self.late = "throttle_dead_time" in faults or "steering_dead_time" in faults
        self.trim = torch.stack(
            torch.broadcast_tensors(
                faults["throttle_offset.offset"], faults["steering_offset.offset"]
            )
        )  # (2, *)
        self.dead_time = torch.stack(
            torch.broadcast_tensors(
                faults["throttle_dead_time.dead_time"], faults["steering_dead_time.dead_time"]
            )
        )
        self.kept = math.ceil(float(self.dead_time.max()) / dt - 1e-6) if self.late else 0
        self.weights = self._weights(dt, substeps) if self.late else None

    def received(self, line: Tensor | None, action: Tensor) -> tuple[Tensor, Tensor | None]:
        """Commands of each substep.

        Args:
            line: [*, K, 2] commands of the last periods, newest first; None without a dead time.
            action: [*, 2] of this period.

        Returns:
            Commands [S, 2, *], of one row for all substeps without a dead time, and the line one
            period later.
        """
        command = action.movedim(-1, 0)
        if self.trimmed:  # to the ends of the channel
            command = (command + self.trim).clamp(-1.0, 1.0)
        if line is None or self.weights is None:
            return command.unsqueeze(0), line
        given = torch.cat([command.unsqueeze(0), line.movedim((-2, -1), (0, 1))])  # (K + 1, 2, *)
        arriving = (self.weights * given).sum(1)  # (S, 2, *)
        line = given[:-1].movedim((0, 1), (-2, -1)).contiguous()
        return torch.where(self.dead_time > 0, arriving, command), line

    def _weights(self, dt: float, substeps: int) -> Tensor:
        """Weights [S, K + 1, 2, *] of the commands in those of the substeps."""
        shape = (-1, *[1] * (self.dead_time.dim() + 1))
        begin = torch.arange(substeps, dtype=torch.float64) * (dt / substeps)
        begin = begin.reshape(shape).to(self.dead_time.device) - self.dead_time.double()
        given = -dt * torch.arange(self.kept + 1, dtype=torch.float64, device=begin.device)
        given = given.reshape(shape[:-1])  # (K + 1, 1, *1)
        overlap = torch.minimum(begin + dt / substeps, given + dt) - torch.maximum(begin, given)
        return (overlap.clamp_min(0.0) * (substeps / dt)).to(self.dead_time)


class SecondOrderLag:
    """A second-order lag without overshoot.

    Two first-order lags in series, of 85 % and 15 % of the time constant: its mean delay is that
    of one first-order lag, but its response begins with slope 0.

    Args:
        time_constant: [*] [s]; 0 is no lag.
        dt: Step [s].
    """

    def __init__(self, time_constant: Tensor, dt: float) -> None:
        self.none = time_constant <= 0
        slow = ((1.0 - ATTACK) * time_constant).clamp_min(SHORTEST)
        fast = (ATTACK * time_constant).clamp_min(SHORTEST)
        self.slow, self.fast = -torch.expm1(-dt / slow), -torch.expm1(-dt / fast)

    def moved(self, state: Tensor, target: Tensor) -> Tensor:
        """State [2, *] after a step towards a target [*]; its last row is the output."""
        first, second = state
        first = first + self.slow * (target - first)
        # The mean of the first over the step, so that the second is not half a step early.
        second = second + self.fast * (0.5 * (state[0] + first) - second)
        first = torch.where(self.none, target, first)
        return torch.stack([first, torch.where(self.none, target, second)])


GIVING = 0.008  # [s] in which a linkage gives way by 63 %: a servo saver's spring at 20 Hz; chosen
REACHED = 0.1  # [-] share of the breakaway error at which a sticking servo stops again; chosen
FRICTION = 0.4  # [m/s^2] of roll, at which the tyres have taken up 71 % of the play; chosen


class SteeringServo:
    """A servo that moves a linkage which turns the front wheels.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        track_width: [m].
        wheelbase: [m].
        faults: Of servo and linkage.
        dt: Substep [s] of `smoothed`.
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        track_width: float,
        wheelbase: float,
        faults: Faults | None = None,
        dt: float = 1e-3,
    ) -> None:
        faults = faults or Faults({}, values["lock_left"])
        self.values = values
        left, right = values["lock_left"], values["lock_right"]
        self.gain = 0.5 * (left + right) * faults["steering_gain.gain"]
        self.asymmetry = 0.5 * (left - right) * faults["steering_gain.gain"]
        self.trim = values["steering_trim"]
        self.splay = sides(self.trim) * values["ackermann"] * (0.5 * track_width / wheelbase)
        self.rate = torch.minimum(values["steering_rate"], faults["steering_rate_limit.rate"])

        self.breakaway = {
            SERVO_MOVES: faults["sticky_servo.breakaway"],
            STICKS: faults["servo_stiction.width"],
        }
        self.half_play = 0.5 * faults["steering_backlash.width"]
        self.more_left = faults["steering_asymmetry.left_to_right"].sqrt()
        self.lag = SecondOrderLag(faults["steering_lag.time_constant"], dt)
        self.gradient = faults["understeer.gradient"]
        self.giving = -torch.expm1(-dt / torch.full_like(self.gradient, GIVING))
        self.asymmetric = "steering_asymmetry" in faults
        self.dead = faults["steering_dead_zone.width"]
        self.bent = faults["steering_curve.curvature"]
        self.loose = 0.5 * faults["steering_play.width"]
        left, right = (faults[f"steering_end_stop.{side}_cut"] for side in ("left", "right"))
        self.stops = right - 1.0, 1.0 - left
        self.faults = faults

    def moved(self, servo: Tensor, command: Tensor, dt: float) -> Tensor:
        """Servo position [*] after a step towards the command [*], both in [-1, 1].

        ds/dt = clip((c - s) / tau, -rate, rate), exact where the rate does not limit.
        """
        follow = -torch.expm1(-dt / self.values["steering_lag"])
        step = self.rate * dt
        return servo + torch.clamp((command - servo) * follow, -step, step)

    def unstuck(
        self,
        fault_state: dict[str, Tensor],
        servo: Tensor,
        command: Tensor,
        state: str = SERVO_MOVES,
    ) -> Tensor:
        """Target of a servo [*] that sticks: the command [*] if far enough off, else where it is.

        Moves from |c - s| > b on, until |c - s| < 0.1 b. `state` says of which of the two faults.
        """
        error, breakaway = (command - servo).abs(), self.breakaway[state]
        going = fault_state[state].squeeze(0) > 0.5
        going = (error > breakaway) | (going & (error > REACHED * breakaway))
        fault_state[state] = going.to(servo).unsqueeze(0)
        return torch.where(going | (breakaway <= 0), command, servo)

    def centred(self, command: Tensor) -> Tensor:
        """Command [*] behind a dead centre of d to either side: clip(c - d, 0) + clip(c + d, 0)."""
        past_left = (command - self.dead).clamp_min(0.0)
        return past_left + (command + self.dead).clamp_max(0.0)

    def linked(self, rack: Tensor, roll: Tensor) -> Tensor:
        """Wheel position [*] held by the linkage, for a rack [*] and the car's roll [*] [m/s^2].

        Tyres take up the play p against the bend, a / sqrt(a^2 + a_0^2) of half of it; the map is
        bent to (1 - k) x + k x^3; a stop ends it.
        """
        if "steering_play" in self.faults:
            rack = rack - self.loose * roll * torch.rsqrt(roll.square() + FRICTION**2)
        if "steering_curve" in self.faults:
            rack = torch.lerp(rack, rack.pow(3), self.bent)
        if "steering_end_stop" in self.faults:
            low, high = self.stops
            rack = torch.maximum(torch.minimum(rack, high), low)
        return rack

    def smoothed(self, fault_state: dict[str, Tensor], command: Tensor) -> Tensor:
        """Set point [*] of a servo behind a further lag of its command [*], after a step."""
        fault_state[SET_POINT] = self.lag.moved(fault_state[SET_POINT], command)
        return fault_state[SET_POINT][1]

    def followed(self, fault_state: dict[str, Tensor], servo: Tensor) -> Tensor:
        """Position [*] of the rack behind the play of the servo [*].

        x = clip(x, s - w / 2, s + w / 2).
        """
        rack = fault_state[RACK].squeeze(0)
        rack = torch.clamp(rack, servo - self.half_play, servo + self.half_play)
        fault_state[RACK] = rack.unsqueeze(0)
        return rack

    def given_way(self, fault_state: dict[str, Tensor], front: Tensor) -> None:
        """Lets the linkage give way towards k F / m of the front axle, F / m [*] [m/s^2]."""
        back = fault_state[GIVES].squeeze(0)
        back = back + self.giving * (self.gradient * front - back)
        fault_state[GIVES] = back.unsqueeze(0)

    def angle(self, rack: Tensor) -> Tensor:
        """Mean road-wheel angle [*] [rad] of a linkage with different locks.

        delta = a s + b s^2 + trim, with a + b the left lock and a - b the right one.
        """
        angle = rack * (self.gain + self.asymmetry * rack)
        return (angle * self._side(rack) if self.asymmetric else angle) + self.trim

    def servo_at(self, angle: Tensor) -> Tensor:
        """Servo position [*] that makes a road-wheel angle [*] [rad], within [-1, 1]."""
        x = angle - self.trim
        x = x / self._side(x) if self.asymmetric else x
        root = (self.gain.square() + 4.0 * self.asymmetry * x).clamp_min(0.0).sqrt()
        return (2.0 * x / (self.gain + root)).clamp(-1.0, 1.0)

    def _side(self, left: Tensor) -> Tensor:
        return torch.where(left > 0, self.more_left, 1.0 / self.more_left)

    def directions(self, rack: Tensor, turned: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Cosine and sine [4, *] of the angle of each wheel.

        cot(delta_i) = cot(delta) -+ k t / (2 L): the inner wheel is turned more, with k = 1 so
        that all wheels roll about one point.

        Args:
            rack: [*] position of the linkage, in command units.
            turned: [2, *] angle of each front wheel beside the linkage's [rad].
        """
        angle = self.angle(rack)
        angle = angle if turned is None else angle + turned
        sin = torch.sin(angle)
        forward = torch.cos(angle) - self.splay * sin  # (2, *)
        scale = torch.rsqrt(forward.square() + sin.square())
        straight = torch.zeros_like(forward)
        return torch.cat([forward * scale, straight + 1.0]), torch.cat([sin * scale, straight])
