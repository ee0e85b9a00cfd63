"""The time that control runs on: monotonic, so that no step of the wall clock reaches it."""

import time


class Clock:
    """Monotonic time of this computer, the same in all of its processes.

    Args:
        speed: Seconds of this clock in a real one; above 1 only where the car is simulated.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed

    def now(self) -> float:
        """The time [s]."""
        return time.monotonic() * self.speed

    def sleep(self, seconds: float) -> None:
        """Waits for so many seconds of this clock."""
        time.sleep(max(0.0, seconds) / self.speed)


def wall_time() -> str:
    """Date and time, ISO 8601; a label for people, never used for control."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
