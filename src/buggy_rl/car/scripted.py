"""A person who is not there: presses the button by a schedule, so that tests need no hands."""

from typing import Any, Mapping, NamedTuple, Optional

from buggy_rl.car.interfaces import Command, Pilot
from buggy_rl.car.settings import section

LONGEST_PRESS = 0.2  # [s] in which the button arms if it does


class Schedule(NamedTuple):
    """When the button is pressed."""

    press_after: float = 0.5
    """From the start, and from each disarming, until the button is pressed [s]."""
    again: bool = False
    """Arms the car again after it was disarmed; false: once only."""


class ScriptedPilot(Pilot):
    """Leaves the car to the policy and holds the button.

    A press that did not arm for `LONGEST_PRESS` is repeated. After a disarming the button is
    released, and pressed again if the schedule says so.

    Args:
        schedule: When.
    """

    def __init__(self, schedule: Optional[Schedule] = None) -> None:
        self.schedule = schedule or Schedule()
        self._wait = self.schedule.press_after
        self._held, self._armed, self._done = False, False, False
        self._driven = False

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "ScriptedPilot":
        """Of its settings, those of `Schedule`."""
        return cls(section(Schedule, settings, "pilot", {"press_after": (0.02, 60.0)}))

    def command(self, dt: float) -> Optional[Command]:
        self._wait -= dt
        if self._held and not self._driven and self._wait < -LONGEST_PRESS:
            self._held, self._wait = False, self.schedule.press_after
        elif self._wait <= 0 and not self._done:
            self._held = True
        return None

    @property
    def hold_to_drive(self) -> bool:
        return self._held

    def show(self, armed: bool, message: str) -> None:
        self._driven = armed
        if armed:
            self._armed = True
            return
        self._held, self._wait = False, self.schedule.press_after
        self._done = self._armed and not self.schedule.again
