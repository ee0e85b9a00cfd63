"""Readings of a car that drives straight on, for tests of the safety rules and of recordings."""

import math

from buggy_rl.car.interfaces import NEUTRAL, Reading
from buggy_rl.car.recorder import RecorderRow, Written
from buggy_rl.car.safety import Anywhere, Safety
from buggy_rl.car.supervisor import Supervisor

PERIOD = 0.01
SPEED = 1.0  # [m/s]
POLICY = (-0.5, 0.3)
ORIGIN = 100.0  # [s] of recordings


def reading(stamp, **changes):
    """At x = t of a car that drives along x at 1 m/s."""
    made = Reading(stamp, (SPEED * stamp, 0.0, 0.0), (SPEED, 0.0, 0.0), 1.0)
    return made._replace(**changes)


def row(t, **changes):
    """At time t [s] of a recording; the throttle is t / 100, so that rows can be told apart."""
    wavy = (t + 1e-4 * math.sin(50 * t), 0.0, 0.0)
    seen = reading(ORIGIN + t, pose=wavy, **changes)
    return RecorderRow(seen, Written(ORIGIN + t - 0.004, t / 100 - 1, 0.1), True, "policy")


class Drive:
    """A supervisor in steps of 10 ms, with a car that is seen 2 ms before each."""

    def __init__(self, safety=None, fence=None, at_rest=NEUTRAL):
        self.supervisor = Supervisor(safety or Safety(), fence or Anywhere(), at_rest)
        self.now, self.hold, self.own, self.policy, self.hardware = 10.0, False, None, POLICY, ""
        self.decisions = []

    def run(self, seconds, readings=None):
        """Steps on; `readings(stamp)` gives the readings of a step, by default one."""
        for _ in range(round(seconds / PERIOD)):
            self.now += PERIOD
            stamp = self.now - 0.002
            new = [reading(stamp)] if readings is None else readings(stamp)
            self.supervisor.observe(self.now, new)
            self.decisions.append(
                self.supervisor.decide(
                    self.now, PERIOD, self.hold, self.own, self.policy, self.hardware
                )
            )
        return self

    def arm(self):
        """Releases, presses, and drives until the command is the policy's."""
        self.hold = False
        self.run(0.2)
        self.hold = True
        self.run(0.2)
        assert self.last.armed
        return self

    @property
    def last(self):
        return self.decisions[-1]

    @property
    def message(self):
        return self.supervisor.message

    def seconds_until(self, condition, begin):
        """From step `begin` until a decision first fulfils a condition, and holds it to the end."""
        held = [condition(decision) for decision in self.decisions[begin:]]
        assert held[-1], "never"
        broken = [index for index, value in enumerate(held) if not value]
        return PERIOD * (broken[-1] + 1 if broken else 0)
