"""Unknown effects at the wheels and of the air: seams, flat spot, wound thread, nut, shell."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, to_body
from buggy_rl.proof.plants.rally.body import AIR_DENSITY, compression, wheel_places
from buggy_rl.proof.plants.rally.unknown_base import Unknown, hump, wrap


class FloorSeams(Unknown):
    """Raised seams of a tiled floor (0.5 m pitch both ways) throw the wheels up.

    Mechanism: a seam is a hump 3 cm wide; it works on the springs and, through the slope of the
    hump, pushes the wheel back and forth with the wheel load, so no energy is made.
    size: height of the seams, m.
    """

    name, low, high = "floor_seams", 0.0003, 0.004
    mechanism = "raised tile seams lift single wheels, unload tyres and push wheels back"

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Floor height, its slope in the body frame and its rate below each wheel."""
        x, y = wheel_places(self.k, state)
        height_x, slope_x = self._seam(x, 5)
        height_y, slope_y = self._seam(y, 6)
        grade_x, grade_y = to_body(state["yaw"], self.wide * slope_x, self.wide * slope_y)
        rate = grade_x * col(state["vx"]) + grade_y * col(state["vy"])
        inputs["road"] = inputs["road"] + self.wide * (height_x + height_y)
        inputs["road_rate"] = inputs["road_rate"] + rate
        inputs["grade_x"] = inputs["grade_x"] + grade_x
        inputs["grade_y"] = inputs["grade_y"] + grade_y

    def _seam(self, place: Array, index: int) -> tuple[Array, Array]:
        """Height and slope of the hump nearest to a world coordinate [N, 4]."""
        turned = place / 0.5 - col(self.hidden(index))
        return hump(0.5 * (turned - np.floor(turned + 0.5)), 0.015)


class FlatSpot(Unknown):
    """The rear-left tyre has a flat spot from a long slide with a locked wheel.

    Mechanism: once per turn the wheel drops by the depth of the flat, which unloads the tyre at
    one wheel angle; lifting the car out of the flat takes torque from the wheel.
    size: depth, m.
    """

    name, low, high = "flat_spot", 0.0004, 0.005
    mechanism = "flat spot unloads the rear-left tyre and brakes its wheel once per turn"

    def start(self, state: Arrays) -> Arrays:
        """Wheel angle of the rear-left wheel, rad [N]."""
        return {
            self.key("angle"): 2.0 * np.pi * self.hidden(0),
            self.key("load"): np.zeros(self.cars),
        }

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Drop of the wheel centre and torque of the load on the flat."""
        height, slope = hump(wrap(state[self.key("angle")]), 0.6)
        wheel = np.array([0.0, 0.0, 1.0, 0.0])
        drop, torque = -self.size * height, self.size * slope * state[self.key("load")]
        rate = -self.size * slope * state["wheel"][:, 2]
        inputs["road"] = inputs["road"] + col(drop) * wheel
        inputs["road_rate"] = inputs["road_rate"] + col(rate) * wheel
        inputs["wheel_torque"] = inputs["wheel_torque"] + col(torque) * wheel

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Turn the wheel angle on."""
        angle = state[self.key("angle")] + dt * state["wheel"][:, 2]
        state[self.key("angle")] = angle
        state[self.key("load")] = signals["load"][:, 2].copy()


class ThreadWrap(Unknown):
    """A carpet thread winds up on the front-left axle until it snaps.

    Mechanism: the wound length grows with wheel turns, the pull of the tightening coil grows with
    its square, and after 12 to 24 turns the thread breaks and a new one starts.
    size: braking torque just before it breaks, N m.
    """

    name, low, high = "thread_wrap", 0.008, 0.15
    mechanism = "a thread winds up on the front-left axle, brakes it ever more, then snaps"

    def start(self, state: Arrays) -> Arrays:
        """Turns wound, [N]."""
        return {self.key("turns"): 6.0 * self.hidden(1)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Braking torque on the front-left wheel."""
        part = state[self.key("turns")] / self._strength()
        inputs["resist"] = inputs["resist"] + col(self.size * part * part) * [1.0, 0.0, 0.0, 0.0]

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Wind on, snap at the strength of the thread."""
        turn = dt * np.abs(state["wheel"][:, 0]) / (2.0 * np.pi)
        turns = state[self.key("turns")] + turn
        state[self.key("turns")] = np.where(turns > self._strength(), 0.0, turns)

    def _strength(self) -> Array:
        """Turns at which the thread breaks, [N]."""
        return 12.0 + 12.0 * self.hidden(2)


class WheelNut(Unknown):
    """The nut of the rear-right wheel works loose with the turns and the wheel tilts on its hub.

    Mechanism: the play opens over 15 turns; within it the wheel swings to the side to which the
    tyre force pushes (dry, 20 ms) and wobbles once per turn. size: play when loose, rad.
    """

    name, low, high = "wheel_nut", 0.008, 0.1
    mechanism = "a wheel nut loosens with turns; the wheel swings within growing play and wobbles"

    def start(self, state: Arrays) -> Arrays:
        """Turns since tightening and present swing (share of the play), [N]."""
        return {self.key("turns"): 8.0 * self.hidden(3), self.key("swing"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Toe of the rear-right wheel."""
        turns = state[self.key("turns")]
        wobble = 0.4 * np.sin(2.0 * np.pi * turns)
        toe = self.size * np.minimum(turns / 15.0, 1.0) * (state[self.key("swing")] + wobble)
        inputs["toe"] = inputs["toe"] + col(toe) * [0.0, 0.0, 0.0, 1.0]

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """The swing follows the sign of the side force; the sense is that of yielding."""
        swing, push = state[self.key("swing")], limit(signals["force_y"][:, 3] / 0.5, -1.0, 1.0)
        state[self.key("swing")] = swing + (push - swing) * (dt / 0.02)
        turn = dt * np.abs(state["wheel"][:, 3]) / (2.0 * np.pi)
        state[self.key("turns")] = state[self.key("turns")] + turn


class ShellLift(Unknown):
    """The body shell pops up at the front above a speed and drops back at a lower one.

    Mechanism: the inner pressure opens the shell above 2.2 m/s, it closes below 1.5 m/s; open,
    it brakes and lifts the front. size: added area for drag and for front lift, m^2.
    """

    name, low, high = "shell_lift", 0.01, 0.15
    mechanism = "the shell pops open above a speed (hysteresis): drag and front lift jump"

    def start(self, state: Arrays) -> Arrays:
        """Whether open, and the opening (share), [N]."""
        return {self.key("open"): np.zeros(self.cars), self.key("part"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Drag at the centre of gravity and lift at the front axle."""
        speed = np.maximum(state["vx"], 0.0)
        push = 0.5 * AIR_DENSITY * self.size * speed * speed * state[self.key("part")]
        inputs["force_x"] = inputs["force_x"] - push
        inputs["lift"] = inputs["lift"] + push
        inputs["pitch_moment"] = inputs["pitch_moment"] - push * self.k["wheel_x"][:, 0]

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Speed thresholds with hysteresis, then a quick swing of the shell."""
        threshold = np.where(state[self.key("open")] > 0.5, 1.5, 2.2)
        state[self.key("open")] = (state["vx"] > threshold).astype(float)
        part = state[self.key("part")]
        state[self.key("part")] = part + (state[self.key("open")] - part) * (dt / 0.06)


class PanelRub(Unknown):
    """A body panel touches a tyre when the corner is compressed far enough, and wears away.

    Mechanism: contact beyond a clearance of 1.5 mm of suspension travel brakes that wheel; the
    heat of rubbing melts the panel, so the clearance grows with the friction work.
    size: braking torque at 3 mm of overlap, N m.
    """

    name, low, high = "panel_rub", 0.01, 0.25
    mechanism = "a panel brakes a tyre beyond a suspension travel and melts back as it rubs"

    def start(self, state: Arrays) -> Arrays:
        """Clearance of each corner, m [N, 4]."""
        return {self.key("gap"): np.full((self.cars, 4), 0.0015)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Braking torque by overlap."""
        inputs["resist"] = inputs["resist"] + self._torque(state)

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """The panel recedes by 1 mm for 20 J of friction work."""
        work = dt * self._torque(state) * np.abs(state["wheel"])
        state[self.key("gap")] = np.minimum(state[self.key("gap")] + work * 0.001 / 20.0, 0.02)

    def _torque(self, state: Arrays) -> Array:
        """Friction torque of each wheel, N m [N, 4]."""
        over = compression(self.k, state) - state[self.key("gap")]
        return self.wide * limit(over / 0.003, 0.0, 1.0)


WHEEL = (FloorSeams, FlatSpot, ThreadWrap, WheelNut, ShellLift, PanelRub)
