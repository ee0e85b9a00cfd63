"""How far a process that must speak once a period is behind, over its last messages."""

GRANTED = 2.0  # periods between two messages that are not counted
DRAIN = 0.15  # of the time that messages come as they should, taken off what was behind
LARGEST = 0.04  # [s] that a gap counts for at most: a single stall has a limit of its own, 0.1 s
MOST = 0.043  # [s] behind, from which the process is too slow
REMEMBERED = 0.06  # [s] at most: what kept up for 0.1 s is no longer too slow


class Lateness:
    """behind' = max(0, behind - DRAIN min(gap, granted)) + min(max(0, gap - granted), LARGEST).

    A loop that is stopped for 80 ms again and again, or that runs at 25 Hz instead of 100, is never
    silent for 0.1 s, and its commands are old nevertheless. At 100 Hz a process that keeps up
    45 messages a second is never too slow, one of 25 is after 0.12 s.

    Args:
        period: Between two messages [s].
    """

    def __init__(self, period: float) -> None:
        self._granted = GRANTED * period
        self._behind = 0.0

    def add(self, gap: float) -> None:
        """Takes the time [s] between two messages."""
        self._behind = min(self.behind(gap), REMEMBERED)

    def behind(self, gap: float) -> float:
        """How far it is behind [s] if the gap so far is as long as this one [s]."""
        drained = max(0.0, self._behind - DRAIN * min(gap, self._granted))
        return drained + min(max(0.0, gap - self._granted), LARGEST)

    def too_slow(self, gap: float) -> bool:
        """Whether it is too slow already, the gap [s] being as long as this."""
        return self.behind(gap) > MOST

    def patience(self) -> float:
        """The gap [s] from which it is too slow; infinite if no single one is."""
        needed = MOST - max(0.0, self._behind - DRAIN * self._granted)
        return self._granted + needed if needed < LARGEST else float("inf")
