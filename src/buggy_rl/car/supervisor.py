"""Who drives: a person before the policy, and the safety rules above both.

The only place that decides what the wheels get. It reads no clock and no device, so that every rule
is a fact about its arguments.
"""

import math
from typing import Iterable, NamedTuple, Optional

from buggy_rl.car.commands import CommandLimits, command_fault
from buggy_rl.car.interfaces import NEUTRAL, Command, Reading
from buggy_rl.car.readings import ReadingJudge
from buggy_rl.car.safety import Geofence, Safety


class Arming:
    """Arms on a press of the hold-to-drive button, which must have been released before.

    A press while something is in the way is used up: the button must be released and pressed again.
    """

    def __init__(self) -> None:
        self.armed = False
        self.message = "release and press the button to arm"
        """Why the car is armed or not."""
        self._released = False

    def disarm(self, reason: str) -> None:
        """Takes the drive away until the next press."""
        self.armed, self.message, self._released = False, reason, False

    def update(self, hold: bool, obstacle: str) -> None:
        """Takes the button's state.

        Args:
            hold: The button is pressed now.
            obstacle: What forbids to arm; empty if nothing does.
        """
        if not hold:
            if self.armed:
                self.disarm("the button was released")
            self._released = True
        elif self._released:
            self._released = False
            self.armed = not obstacle
            self.message = f"cannot arm: {obstacle}" if obstacle else "armed"


AT_REST = 0.1  # of a person's throttle away from no drive, at which the car can be armed


class Decision(NamedTuple):
    """What the wheels get."""

    command: Command
    source: str
    """policy, person, coast or neutral."""
    armed: bool


class Supervisor:
    """Arms, coasts, disarms, and bounds the commands.

    In each step call `observe`, then `decide`.

    Args:
        safety: The limits.
        fence: Where the car may be.
        at_rest: No drive, wheels straight ahead.
    """

    def __init__(self, safety: Safety, fence: Geofence, at_rest: Command = NEUTRAL) -> None:
        self.safety, self.fence, self.at_rest = safety, fence, at_rest
        self.readings = ReadingJudge(safety)
        self.limits = CommandLimits(safety, at_rest)
        self.arming = Arming()
        self._sound = -math.inf

    @property
    def armed(self) -> bool:
        """The car may drive."""
        return self.arming.armed

    @property
    def message(self) -> str:
        """Why it may or may not."""
        return self.arming.message

    def observe(self, now: float, new: Iterable[Reading]) -> bool:
        """Judges the readings since the last step; returns whether the car can drive by them."""
        readings, limits = self.readings, self.safety
        if not self.armed and readings.age(now) > limits.disarm_after:
            readings.reset()
        readings.judge(now, new, armed=self.armed)
        sound = readings.fresh_for(now) >= limits.recovered_after
        if sound:
            self._sound = now
        return sound

    def decide(
        self,
        now: float,
        dt: float,
        hold: bool,
        own: Optional[Command],
        policy: Optional[Command],
        hardware: str = "",
    ) -> Decision:
        """What the wheels get from `now` on.

        Args:
            now: The time [s].
            dt: Since the last step [s].
            hold: The button is held.
            own: The person's command, or None.
            policy: The policy's command, or None where it has none.
            hardware: What is wrong with the actuator; empty if nothing is.
        """
        chosen = own if own is not None else policy
        self.arming.update(hold, hardware or self._obstacle(now, own))
        fault = self._fault(now, chosen, hardware) if self.armed else ""
        if fault:
            self.arming.disarm(fault)
        if not self.armed:
            return Decision(self.limits.set(self.at_rest), "neutral", False)
        if now > self._sound:
            return self._coast(own, dt)
        if chosen is None:
            return Decision(self.limits.bounded(self.at_rest, dt), "neutral", True)
        source = "person" if own is not None else "policy"
        return Decision(self.limits.bounded(chosen, dt), source, True)

    def _coast(self, own: Optional[Command], dt: float) -> Decision:
        """No drive; the wheels stay as they are, or go where a person turns them."""
        steering = self.limits.last[1] if own is None else own[1]
        return Decision(self.limits.bounded((self.at_rest[0], steering), dt), "coast", True)

    def _fault(self, now: float, chosen: Optional[Command], hardware: str) -> str:
        """What disarms an armed car."""
        if hardware:
            return hardware
        if chosen is not None and command_fault(chosen):
            return command_fault(chosen)
        limits = self.safety
        if now - self._sound > limits.disarm_after - limits.coast_after:
            return self.readings.complaint(now)
        return self._outside()

    def _outside(self) -> str:
        good = self.readings.good
        if good is None or self.fence.holds(*good.pose[:2]):
            return ""
        x, y, _ = good.pose
        return f"the car is outside the fence, at ({x:.2f}, {y:.2f}) m"

    def _obstacle(self, now: float, own: Optional[Command]) -> str:
        """What forbids to arm."""
        if own is not None and abs(own[0] - self.at_rest[0]) > AT_REST:
            return f"the person's throttle is at {own[0]:.2f}, not at rest"
        if now > self._sound:
            return self.readings.complaint(now)
        return self._outside()
