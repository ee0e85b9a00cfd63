"""Table 7.4 of the original study: a person's drives, as scripts/drive.py wrote them.

Where nobody has driven a path, a scripted driver stands in, and its row says so.
"""

import datetime
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean, pstdev

from buggy_rl.car.clock import Deadlines
from buggy_rl.core.config import from_plain
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.policies.people import LIMITS, DriveConfig, LiveStep


@dataclass(frozen=True)
class DriveNote:
    """Options and result of one drive."""

    driver: str
    """human or scripted."""
    input: str
    """keyboard, gamepad, joystick or pure_pursuit."""
    simulator: str
    """Simulator as it was named."""
    course: str
    """Course as it was named."""
    seed: int
    """Seed of the simulator's noise."""
    date: str
    """Begin, ISO 8601."""
    limit: float
    """Longest drive [s]."""
    finished: bool = False
    """The drive ended by its own rules; false while it goes on and if it was broken off."""
    seconds: float = 0.0
    """Time driven [s]."""
    waypoints: int = 0
    """Waypoints closed."""
    overruns: int = 0
    """Steps that came more than a period late."""
    slipped: float = 0.0
    """Time by which real time ran ahead of the drive [s]; above 0: driven slower than real."""

    @classmethod
    def of(cls, config: DriveConfig) -> "DriveNote":
        """Makes the note at the begin of a drive."""
        scripted = config.driver == "scripted"
        who, what = ("scripted", "pure_pursuit") if scripted else ("human", config.driver)
        date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        limit = config.steps * CONTROL_PERIOD
        return cls(who, what, config.simulator, config.course, config.seed, date, limit)

    def ended(self, last: LiveStep, deadlines: Deadlines) -> "DriveNote":
        """Note at the end of the drive that `last` is the last row of."""
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


COURSES = ("lap", "infinity", "random")
SLOWEST = 0.02  # of a drive that may be lost to a slow simulator: beyond, it was slow motion
ORIGINAL = {  # printed; path -> simulator
    "lap": {"learned": "58.3", "mujoco": "68.7"},
    "infinity": {"learned": "64.7", "mujoco": "70.3"},
    "random": {"learned": "32.7", "mujoco": "31.0"},
}


@dataclass(frozen=True)
class HumanDrives:
    """Drives that count, and why others do not."""

    waypoints: dict[tuple[str, str, str], list[int]] = field(default_factory=dict)
    """Closed, by driver (human, scripted), simulator and course."""
    left_out: list[str] = field(default_factory=list)
    """A line each."""


def human_drives(folder: Path, simulators: Mapping[str, str]) -> HumanDrives:
    """The drives in a folder that were made as the policies' are: same simulator, path and length.

    Args:
        folder: Of recordings with a note each; none of it need exist.
        simulators: What the tables call each simulator, and what it is.

    Raises:
        ValueError: A note cannot be read.
    """
    found = HumanDrives()
    for recording in sorted(folder.glob("*.csv")):
        file = recording.with_suffix(".json")
        if not file.is_file():
            found.left_out.append(f"{recording.name}: there is no {file.name} that says who drove")
            continue
        note = read_note(file)
        places = [name for name, what in simulators.items() if _same(what, note.simulator)]
        reason = _unfit(note, places)
        if reason:
            found.left_out.append(f"{recording.name}: {reason}")
        for place in () if reason else places:
            key = note.driver, place, note.course
            found.waypoints.setdefault(key, []).append(note.waypoints)
    return found


def human_lines(found: HumanDrives, places: Sequence[str]) -> list[str]:
    """The table as Markdown; one line that says what is missing where nobody has driven."""
    rows = [_row(found, course, places) for course in COURSES]
    rows = [row for row in rows if row]
    left_out = [f"Left out: {line}." for line in found.left_out]
    if not rows:
        return ["", "Table 7.4: the human driver's row is left for a person to drive.", *left_out]
    columns = "".join(f" in {place} |" for place in places)
    return [
        "", "Table 7.4: the human driver:", "", f"| driver | path |{columns}",
        "|---|---|" + "---|" * len(places), *rows, *([""] if left_out else []), *left_out,
    ]  # fmt: skip


def _row(found: HumanDrives, course: str, places: Sequence[str]) -> str:
    """Empty where nobody has driven."""
    for driver, name in (("human", "human"), ("scripted", "human (scripted driver)")):
        values = [found.waypoints.get((driver, place, course), []) for place in places]
        if any(values):
            cells = [_cell(v, course, place) for v, place in zip(values, places, strict=True)]
            return f"| {name} | {course} | {' | '.join(cells)} |"
    return ""


def _cell(values: Sequence[int], course: str, place: str) -> str:
    printed = ORIGINAL[course].get(place, "-")
    return f"{mean(values):.1f} ± {pstdev(values):.1f} ({printed})" if values else f"- ({printed})"


def _unfit(note: DriveNote, places: Sequence[str]) -> str:
    """Why a drive does not count; empty if it does."""
    limit = LIMITS.get(note.course, 0) * CONTROL_PERIOD
    if note.driver not in ("human", "scripted"):
        return f"driver {note.driver!r} is neither human nor scripted"
    if not note.finished:
        return "it was broken off"
    if note.course not in COURSES:
        return f"course {note.course!r} is not in the table"
    if abs(note.limit - limit) > CONTROL_PERIOD / 2:
        return f"it may last {note.limit:g} s, the table's drives {limit:g} s"
    if not places:
        return f"simulator {note.simulator!r} is not in the table"
    if note.driver == "human" and note.slipped > SLOWEST * note.seconds:
        return f"{note.slipped:.2f} s of real time were lost: it was driven in slow motion"
    return ""


def _same(one: str, other: str) -> bool:
    return os.path.normpath(one) == os.path.normpath(other)
