"""A folder of recordings: facts of every drive, what they share, what they lack."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.inspection.columns import Guess, exchanged
from buggy_rl.inspection.coverage import Coverage, coverage, missing, suggestions
from buggy_rl.inspection.drive import DriveFacts, inspect_drive
from buggy_rl.inspection.listing import ColumnFacts, listing
from buggy_rl.inspection.proposal import EXCHANGED, chosen_commands, proposal
from buggy_rl.inspection.raw_drive import find_drives

Found = tuple[str, list[Path]]


@dataclass(frozen=True)
class InspectConfig:
    """A folder to look into."""

    output: str = ""
    """Folder for inspection.html, inspection.png and columns.yaml; empty for runs/inspection."""
    most: int = 0
    """Look at so many drives only, spread over the folder; 0 for all."""


@dataclass(frozen=True)
class Inspection:
    """What was found in a folder."""

    folder: str
    drives: list[DriveFacts]
    commands: dict[str, Guess]
    """Channel -> the column that most drives agree on."""
    seen: Coverage
    missing: list[str]
    """What the files lack, one line each."""
    suggestions: list[str]
    """What to drive next, one line each."""
    proposal: str
    """A column map to be edited."""
    first: list[str]
    """What to know before anything else, one line each."""
    columns: list[ColumnFacts]
    """Of the longest drive: every numeric column."""


def inspect_folder(
    folder: Path, most: int = 0, progress: Callable[[list[Found]], Iterable[Found]] = iter
) -> Inspection:
    """Reads all drives of a folder unconverted and says what they hold.

    Args:
        folder: With recordings, or folders of them.
        most: Drives to look at, spread over the folder; 0 for all.
        progress: Wraps the list of drives while they are read, e.g. `tqdm`.

    Raises:
        ValueError: There is no such folder, or no recording in it.
    """
    found = list(find_drives(folder))
    if not found:
        raise ValueError(f"{folder}: no recording below it; expected .csv, .parquet, .npy or a bag")
    if 0 < most < len(found):
        found = [found[round(i * (len(found) - 1) / max(most - 1, 1))] for i in range(most)]
    drives = [inspect_drive(name, files) for name, files in progress(found)]
    commands = chosen_commands(drives)
    seen = coverage(drives, commands)
    return Inspection(
        str(folder),
        drives,
        commands,
        seen,
        missing(drives, commands),
        list(suggestions(seen, len(drives))),
        proposal(drives, commands),
        [EXCHANGED] if exchanged(commands) else [],
        listing(_longest(drives)),
    )


def _longest(drives: list[DriveFacts]) -> DriveFacts:
    """The drive with the longest pose, or without any the one with the most rows."""

    def length(drive: DriveFacts) -> tuple[float, int]:
        rows = max(map(len, drive.raw.tables.values()), default=0) if drive.raw else 0
        return (drive.pose.clock.seconds if drive.pose else 0.0), rows

    return max(drives, key=length)
