"""Unknown effects of what the sensors show; the true motion stays as it is."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, to_world
from buggy_rl.proof.plants.rally.steering import PERIOD
from buggy_rl.proof.plants.rally.unknown_base import Unknown, driven_speed
from buggy_rl.proof.plants.rally.unknown_steer import room_field


class MarkerMast(Unknown):
    """The tracking marker sits on a post and moves with roll and pitch of the body.

    Mechanism: rigid-body lever: roll and pitch shift the marker sideways and forward, as does
    their rate for the shown velocity. size: height of the marker above the axis, m.
    """

    name, low, high = "marker_mast", 0.02, 0.5
    mechanism = "roll and pitch of the body shift a marker on a post, in place and velocity"

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Marker instead of the centre of gravity."""
        x, y = to_world(state["yaw"], self.size * state["pitch"], -self.size * state["roll"])
        extra = np.stack(
            [self.size * state["pitch_rate"], -self.size * state["roll_rate"], np.zeros(self.cars)],
            axis=1,
        )
        return pose + np.stack([x, y, np.zeros(self.cars)], axis=1), velocity + extra


class GyroWarmup(Unknown):
    """The gyro drifts while it warms up and where a wheel shakes it near its resonance.

    Mechanism: bias rises over 3 s with the chip temperature; vibration of an unbalanced wheel is
    rectified, most where the wheel turns at the resonance of the board (6 to 14 turns/s). The
    tracker integrates the rate, so the shown heading wanders. size: bias, rad/s.
    """

    name, low, high = "gyro_warmup", 0.01, 0.4
    mechanism = "gyro bias grows with warm-up and near one wheel speed; heading integrates it"

    def start(self, state: Arrays) -> Arrays:
        """Warmth (share), bias, rad/s, and heading error, rad, [N]."""
        return {self.key(part): np.zeros(self.cars) for part in ("warm", "bias", "error")}

    def finish(self, state: Arrays) -> None:
        """Warm up, find the bias, integrate it."""
        warm = state[self.key("warm")]
        state[self.key("warm")] = warm + PERIOD * (1.0 - warm) / 3.0
        ratio = state["wheel"][:, 0] / (2.0 * np.pi * (6.0 + 8.0 * self.hidden(5)))
        square = ratio * ratio
        shake = 0.1 * square / np.sqrt((1.0 - square) * (1.0 - square) + 0.02 * square)
        bias = self.size * (0.6 * state[self.key("warm")] + np.minimum(shake, 1.0))
        state[self.key("bias")] = bias
        state[self.key("error")] = state[self.key("error")] + PERIOD * bias

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Bias on the yaw rate, its integral on the heading."""
        zero = np.zeros(self.cars)
        return (
            pose + np.stack([zero, zero, state[self.key("error")]], axis=1),
            velocity + np.stack([zero, zero, state[self.key("bias")]], axis=1),
        )


class GlareHold(Unknown):
    """Lamp reflections blind the tracking camera at places; it repeats its last pose there.

    Mechanism: where the glare exceeds a level the tracker holds pose and velocity, up to 0.15 s,
    then finds the car again. size: glare level, about the share of blind floor.
    """

    name, low, high = "glare_hold", 0.01, 0.5
    mechanism = "at places with glare the tracker repeats its last pose, then jumps to the car"

    def start(self, state: Arrays) -> Arrays:
        """Held pose and velocity, [N, 3], and time held, s [N]."""
        held = [np.stack([state[name] for name in names], axis=1) for names in self._names()]
        return {
            self.key("pose"): held[0],
            self.key("velocity"): held[1],
            self.key("age"): np.zeros(self.cars),
        }

    @staticmethod
    def _names() -> tuple[tuple[str, str, str], tuple[str, str, str]]:
        """State parts of pose and velocity."""
        return ("x", "y", "yaw"), ("vx", "vy", "yaw_rate")

    def finish(self, state: Arrays) -> None:
        """Hold in glare, otherwise take over the present pose."""
        glare = (room_field(self, state, 0.53, 0.83) < self.size) & self.active
        age = np.where(glare, state[self.key("age")] + PERIOD, 0.0)
        age = np.where(age > 0.15, 0.0, age)
        for part, names in zip(("pose", "velocity"), self._names(), strict=True):
            now = np.stack([state[name] for name in names], axis=1)
            state[self.key(part)] = np.where(col(age > 0.0), state[self.key(part)], now)
        state[self.key("age")] = age

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Held values instead of the present ones while blind."""
        blind = col(state[self.key("age")] > 0.0)
        return (
            np.where(blind, state[self.key("pose")], pose),
            np.where(blind, state[self.key("velocity")], velocity),
        )


class WheelOdometer(Unknown):
    """The shown forward speed leans on the driven wheels, so wheel slip looks like speed.

    Mechanism: a fusion filter weighs tracker and wheel encoder; the encoder sees the spin of the
    driven wheels, and the shown place gathers part of the slipped way until it is pulled back
    (0.4 s). size: weight of the encoder.
    """

    name, low, high = "wheel_odometer", 0.05, 1.0
    mechanism = "sensor fusion takes driven-wheel spin for speed; slip leaks into speed and place"

    def start(self, state: Arrays) -> Arrays:
        """Way gathered by slip, m [N]."""
        return {self.key("way"): np.zeros(self.cars)}

    def finish(self, state: Arrays) -> None:
        """Slip speed gathers, the tracker pulls back."""
        way, slip = state[self.key("way")], driven_speed(self.k, state) - state["vx"]
        state[self.key("way")] = way + PERIOD * (self.size * slip - way / 0.4)

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Add the slip speed and the gathered way."""
        zero = np.zeros(self.cars)
        slip = self.size * (driven_speed(self.k, state) - state["vx"])
        x, y = to_world(state["yaw"], state[self.key("way")], zero)
        return (
            pose + np.stack([x, y, zero], axis=1),
            velocity + np.stack([slip, zero, zero], axis=1),
        )


class CompassCurrent(Unknown):
    """The heading comes from a compass that the motor current deflects.

    Mechanism: the field of the battery leads adds to that of the earth; the deflection grows with
    the current and depends on the heading (sine of the angle between both fields), and the
    filter of the compass lags by 0.1 s. size: deflection at stall current, rad.
    """

    name, low, high = "compass_current", 0.02, 0.6
    mechanism = "motor current deflects a compass, by current times sine of the heading, lagged"

    def start(self, state: Arrays) -> Arrays:
        """Present deflection, rad [N]."""
        return {self.key("error"): np.zeros(self.cars)}

    def finish(self, state: Arrays) -> None:
        """Deflection with the lag of the compass filter."""
        part = limit(state["current"] / self.k["stall_current"], 0.0, 1.0)
        goal = self.size * part * np.sin(state["yaw"] + 2.0 * np.pi * self.hidden(6))
        error = state[self.key("error")]
        state[self.key("error")] = error + (goal - error) * (PERIOD / 0.1)

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Deflected heading."""
        zero = np.zeros(self.cars)
        return pose + np.stack([zero, zero, state[self.key("error")]], axis=1), velocity


SENSOR = (MarkerMast, GyroWarmup, GlareHold, WheelOdometer, CompassCurrent)
