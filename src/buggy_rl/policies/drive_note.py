"""What stands beside the recording of a drive: who drove what, and how it went."""

import datetime
import json
from dataclasses import dataclass, replace
from pathlib import Path

from buggy_rl.car.deadlines import Deadlines
from buggy_rl.config import from_plain
from buggy_rl.policies.live_drive import DriveConfig, Row
from buggy_rl.vehicle import CONTROL_PERIOD


@dataclass(frozen=True)
class DriveNote:
    """One drive."""

    driver: str
    """human or scripted."""
    input: str
    """keyboard, gamepad, joystick or pure_pursuit."""
    simulator: str
    """As it was named."""
    course: str
    """Likewise."""
    seed: int
    """Of the simulator's noise."""
    date: str
    """Begin, ISO 8601."""
    limit: float
    """Longest drive [s]."""
    finished: bool = False
    """The drive ended by its own rules; false while it goes on and if it was broken off."""
    seconds: float = 0.0
    """Driven [s]."""
    waypoints: int = 0
    """Closed."""
    overruns: int = 0
    """Steps that came more than a period late."""
    slipped: float = 0.0
    """By which real time ran ahead of the drive [s]; above 0 it was driven slower than real."""

    @classmethod
    def of(cls, config: DriveConfig) -> "DriveNote":
        """At the begin of a drive."""
        scripted = config.driver == "scripted"
        who, what = ("scripted", "pure_pursuit") if scripted else ("human", config.driver)
        date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        limit = config.steps * CONTROL_PERIOD
        return cls(who, what, config.simulator, config.course, config.seed, date, limit)

    def ended(self, last: Row, deadlines: Deadlines) -> "DriveNote":
        """At the end of the drive that `last` is the last row of."""
        return replace(
            self,
            finished=True,
            seconds=round(last.time + deadlines.dt, 6),
            waypoints=last.waypoints,
            overruns=deadlines.overruns,
            slipped=round(deadlines.slipped, 3),
        )


def note_file(recording: str | Path) -> Path:
    """The note beside a recording."""
    return Path(recording).with_suffix(".json")


def read_note(file: Path) -> DriveNote:
    """The note in a file.

    Raises:
        ValueError: It is no note.
    """
    try:
        content = json.loads(file.read_text())
    except ValueError as error:
        raise ValueError(f"{file} is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise ValueError(f"{file} is no note of a drive: it is a {type(content).__name__}")
    return from_plain(DriveNote, content, str(file))
