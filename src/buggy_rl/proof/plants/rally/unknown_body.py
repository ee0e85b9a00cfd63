"""Unknown effects of loose or hanging masses and of a dragged cable."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Arrays, limit, to_body
from buggy_rl.proof.plants.rally.body import GRAVITY
from buggy_rl.proof.plants.rally.unknown_base import Unknown


class LooseBattery(Unknown):
    """The battery slides sideways in its tray and hits the stops.

    Mechanism: 16 % of the mass moves against dry friction (0.1) and padded stops (32 Hz); the
    relative motion reacts on the body and the shifted weight tilts it.
    size: free travel to either side, m.
    """

    name, low, high = "loose_battery", 0.004, 0.05
    mechanism = "battery slides in its tray against dry friction and strikes padded stops"

    def start(self, state: Arrays) -> Arrays:
        """Place, m, speed, m/s, and acceleration, m/s^2, relative to the body, [N]."""
        return {self.key(part): np.zeros(self.cars) for part in ("place", "speed", "pull")}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Reaction of the relative acceleration, and weight beside the middle."""
        mass = 0.16 * self.k["mass"]
        push = np.where(self.active, -mass * state[self.key("pull")], 0.0)
        tilt = np.where(self.active, mass * GRAVITY * state[self.key("place")], 0.0)
        inputs["force_y"] = inputs["force_y"] + push
        inputs["roll_moment"] = inputs["roll_moment"] - tilt

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Motion in the tray."""
        place, speed, omega = state[self.key("place")], state[self.key("speed")], 200.0
        over = place - limit(place, -self.size, self.size)
        stop = np.where(over != 0.0, omega * omega * over + 0.5 * omega * speed, 0.0)
        pull = -signals["ay"] - stop - 0.1 * GRAVITY * limit(speed / 0.01, -1.0, 1.0)
        speed = speed + dt * pull
        state[self.key("pull")], state[self.key("speed")] = limit(pull, -150.0, 150.0), speed
        state[self.key("place")] = limit(place + dt * speed, -0.08, 0.08)


class WhipMast(Unknown):
    """A sensor on a flexible mast sways in both directions and shakes the body.

    Mechanism: a mass on a lightly damped elastic rod 0.3 m high (2.5 Hz), excited by the
    acceleration of the car; its spring force acts at the foot and tilts the body.
    size: mass at the tip, kg.
    """

    name, low, high = "whip_mast", 0.02, 0.4
    mechanism = "a mass on an elastic mast sways at 2.5 Hz and pulls and tilts the body"

    def start(self, state: Arrays) -> Arrays:
        """Sway, m, and its rate along body x and y, [N]."""
        return {self.key(part): np.zeros(self.cars) for part in ("x", "y", "rate_x", "rate_y")}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Spring and damper force on the foot and its moments."""
        x, y = self._force(state, "x"), self._force(state, "y")
        inputs["force_x"], inputs["force_y"] = inputs["force_x"] + x, inputs["force_y"] + y
        inputs["roll_moment"] = inputs["roll_moment"] - 0.3 * y
        inputs["pitch_moment"] = inputs["pitch_moment"] + 0.3 * x

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Sway relative to the car; the sway frame turns with the body."""
        turn = dt * state["yaw_rate"]
        for axis, other, sign in (("x", "y", 1.0), ("y", "x", -1.0)):
            pull = -signals["a" + axis] - self._force(state, axis, unit=True)
            state[self.key("new_" + axis)] = state[self.key("rate_" + axis)] + dt * pull
            state[self.key("old_" + axis)] = (
                state[self.key(axis)] + sign * turn * state[self.key(other)]
            )
        for axis in ("x", "y"):
            rate = state.pop(self.key("new_" + axis))
            sway = state.pop(self.key("old_" + axis)) + dt * rate
            state[self.key("rate_" + axis)], state[self.key(axis)] = rate, limit(sway, -0.2, 0.2)

    def _force(self, state: Arrays, axis: str, unit: bool = False) -> np.ndarray:
        """Force of the mast on the body, N [N], or per kilogram."""
        omega = 2.0 * np.pi * 2.5
        pull = (
            omega * omega * state[self.key(axis)] + 0.06 * omega * state[self.key("rate_" + axis)]
        )
        return pull if unit else self.size * pull


class DraggedCable(Unknown):
    """The car drags a cable behind it that is anchored at the start.

    Mechanism: every metre of cable pulled off the coil lies on the floor and its friction pulls
    at the tail; the cable is slack whenever the car comes back towards the anchor, until the
    car exceeds its greatest distance again. size: floor friction per metre, N/m.
    """

    name, low, high = "dragged_cable", 0.1, 2.0
    mechanism = "a cable anchored at the start drags by its longest pay-out, slack on the way back"

    def start(self, state: Arrays) -> Arrays:
        """Anchor in the world and length paid out, m, [N]."""
        return {
            self.key("x"): state["x"].copy(),
            self.key("y"): state["y"].copy(),
            self.key("out"): np.zeros(self.cars),
        }

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Pull towards the anchor at the rear axle while the cable is taut."""
        x, y = state[self.key("x")] - state["x"], state[self.key("y")] - state["y"]
        distance = np.sqrt(x * x + y * y)
        taut = limit((distance - state[self.key("out")] + 0.02) / 0.02, 0.0, 1.0)
        pull = self.size * state[self.key("out")] * taut / (distance + 0.02)
        x, y = to_body(state["yaw"], pull * x, pull * y)
        inputs["force_x"], inputs["force_y"] = inputs["force_x"] + x, inputs["force_y"] + y
        inputs["moment"] = inputs["moment"] + self.k["wheel_x"][:, 2] * y

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """More cable comes off the coil at a new greatest distance."""
        x, y = state[self.key("x")] - state["x"], state[self.key("y")] - state["y"]
        distance = np.sqrt(x * x + y * y)
        state[self.key("out")] = np.maximum(state[self.key("out")], distance)


class SloshTank(Unknown):
    """A half-filled water bottle on the rear deck sloshes along the car.

    Mechanism: the first wave of the liquid is a pendulum mass with a travel-dependent (breaking)
    damping; it pushes the walls forward and back after every change of speed (1.6 Hz).
    size: moving share of water, kg.
    """

    name, low, high = "slosh_tank", 0.03, 0.6
    mechanism = "water sloshes along the car as a wave with damping that grows with its height"

    def start(self, state: Arrays) -> Arrays:
        """Wave offset, m, and its rate, [N]."""
        return {self.key("wave"): np.zeros(self.cars), self.key("rate"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Push of the wave on the walls."""
        push = self.size * self._push(state)
        inputs["force_x"] = inputs["force_x"] + push
        inputs["pitch_moment"] = inputs["pitch_moment"] + 0.08 * push

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Wave motion relative to the bottle."""
        rate = state[self.key("rate")] + dt * (-signals["ax"] - self._push(state))
        wave = state[self.key("wave")] + dt * rate
        state[self.key("rate")], state[self.key("wave")] = rate, limit(wave, -0.1, 0.1)

    def _push(self, state: Arrays) -> np.ndarray:
        """Push per kilogram, m/s^2 [N]; the wave breaks beyond 2 cm."""
        wave, omega = state[self.key("wave")], 2.0 * np.pi * 1.6
        damping = 0.1 + (wave / 0.02) * (wave / 0.02)
        return omega * omega * wave + omega * np.minimum(damping, 4.0) * state[self.key("rate")]


BODY = (LooseBattery, WhipMast, DraggedCable, SloshTank)
