"""Unknown effects of the steering and of the command path."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit
from buggy_rl.proof.plants.rally.unknown_base import Unknown

_FRONT = np.array([1.0, 1.0, 0.0, 0.0])


class WornTooth(Unknown):
    """A servo gear has a worn tooth: within one band of angle the output does not follow.

    Mechanism: while the servo passes the band the rack stays where it entered; at the far edge
    the next tooth catches and the rack jumps (at 20 rad/s). size: width of the band, rad.
    """

    name, low, high = "worn_tooth", 0.01, 0.12
    mechanism = "in one band of angle the rack holds, then jumps when the next gear tooth catches"

    def start(self, state: Arrays) -> Arrays:
        """Angle behind the tooth, rad [N]."""
        return {self.key("held"): state["rack"].copy()}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Front wheels follow the held angle instead of the rack."""
        inputs["toe"] = inputs["toe"] + col(state[self.key("held")] - state["rack"]) * _FRONT

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Hold within the band, follow fast outside; without a band follow at once."""
        rack, held = state["rack"], state[self.key("held")]
        side = np.where(self.hidden(0) > 0.5, 1.0, -1.0)
        centre = side * (0.5 * self.size + 0.01 + 0.06 * self.hidden(1))
        reach = np.where(self.active, 20.0 * dt, np.inf)
        follow = held + limit(rack - held, -reach, reach)
        free = (np.abs(rack - centre) > 0.5 * self.size) | ~self.active
        follow = np.where(self.active, follow, rack)
        state[self.key("held")] = np.where(free, follow, held)


class ServoBrownout(Unknown):
    """A pull of the motor sinks the supply of the servo, which stops until it has restarted.

    Mechanism: when the motor current exceeds 35 % of the stall current the servo resets and
    stands still for a time, then is immune for 0.25 s (its capacitor is full).
    size: standstill, s.
    """

    name, low, high = "servo_brownout", 0.02, 0.25
    mechanism = "high motor current resets the servo, which stands still until restarted"

    def start(self, state: Arrays) -> Arrays:
        """Time left of a standstill, s, negative afterwards, [N]."""
        return {self.key("left"): np.full(self.cars, -1.0)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """No servo motion during the standstill."""
        inputs["servo_rate"] = np.where(state[self.key("left")] > 0.0, 0.0, inputs["servo_rate"])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Trigger by current, then count down."""
        left = state[self.key("left")] - dt
        trigger = (signals["current"] > 0.35 * self.k["stall_current"]) & (left < -0.25)
        state[self.key("left")] = np.where(trigger & self.active, self.size, left)


class KingpinShimmy(Unknown):
    """Soft steering links let the front wheels swing about the kingpins against their trail.

    Mechanism: a spring-mass of links and wheels (9 Hz, little damping) turned by the side force
    times the trail of 12 mm; the tyre lag feeds the swing (Pacejka, chapter on wheel shimmy).
    size: compliance, rad per N m.
    """

    name, low, high = "kingpin_shimmy", 0.03, 0.8
    mechanism = "front wheels swing on elastic links, driven by side force times trail"

    def start(self, state: Arrays) -> Arrays:
        """Swing angle, rad, and its rate, [N]."""
        return {self.key("angle"): np.zeros(self.cars), self.key("rate"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Both front wheels swing together."""
        inputs["toe"] = inputs["toe"] + col(state[self.key("angle")]) * _FRONT

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Spring-mass motion; stops at 0.3 rad."""
        moment = -0.012 * (signals["force_y"][:, 0] + signals["force_y"][:, 1])
        omega, angle = 2.0 * np.pi * 9.0, state[self.key("angle")]
        rate = state[self.key("rate")]
        pull = omega * omega * (self.size * moment - angle) - 0.16 * omega * rate
        rate = limit(rate + dt * pull, -20.0, 20.0)
        state[self.key("angle")] = limit(angle + dt * rate, -0.3, 0.3)
        state[self.key("rate")] = rate


class RadioShadow(Unknown):
    """Metal furniture casts radio shadows: at these places the receiver repeats old commands.

    Mechanism: a standing-wave field over the floor; below the receiver threshold the last good
    command is held and after 0.3 s the receiver cuts the throttle. size: threshold, about the
    share of the floor in shadow.
    """

    name, low, high = "radio_shadow", 0.05, 0.6
    mechanism = "at places of weak radio field the last command is held, later the throttle is cut"

    def start(self, state: Arrays) -> Arrays:
        """Last good command [N, 2] and time since, s [N]."""
        return {
            self.key("last"): np.tile(np.array([-1.0, 0.0]), (self.cars, 1)),
            self.key("age"): np.zeros(self.cars),
        }

    def command(self, state: Arrays, command: Array) -> Array:
        """Held command in a shadow; the receiver keeps its memory in the state."""
        lost = room_field(self, state, 0.45, 0.61) < self.size
        age = np.where(lost, state[self.key("age")] + 0.01, 0.0)
        last = np.where(col(lost), state[self.key("last")], command)
        state[self.key("last")], state[self.key("age")] = last, age
        throttle = np.where(age > 0.3, -1.0, last[:, 0])
        return np.stack([throttle, last[:, 1]], axis=1)


def room_field(effect: Unknown, state: Arrays, half_x: float, half_y: float) -> Array:
    """Strength of a standing wave at the car's place, 0 to 1 [N]; half wavelengths in m."""
    x = np.abs(np.sin(np.pi * (state["x"] / half_x + effect.hidden(2))))
    y = np.abs(np.sin(np.pi * (state["y"] / half_y + 0.25 + 0.5 * effect.hidden(3))))
    return x * y


STEER = (WornTooth, ServoBrownout, KingpinShimmy, RadioShadow)
