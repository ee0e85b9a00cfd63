"""Recordings that a function is given: read already, or by their paths."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.recordings import Recording, load_recordings
from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.loading import doubtful

Drives = str | Path | Sequence[str | Path] | Sequence[Recording]
"""Recordings, or files, folders and patterns of them."""


def drives_of(
    given: Drives,
    says: Callable[[str], object],
    columns: ColumnMap | str | Path | None = None,
    dt: float = CONTROL_PERIOD,
    car: str = "",
    what: str = "drive",
) -> list[Recording]:
    """Recordings that can be used; says which cannot, and what may be wrong with the others.

    Args:
        given: Recordings as they are, or paths to read.
        says: Told one line for each refusal and each doubt; of recordings that were read already
            there are none.
        columns: How tables are read.
        dt: Control period to resample to [s].
        car: Name or file of the car, whose limits hold where the column map states none.
        what: They are, for messages.

    Raises:
        ValueError: None is left, or recordings and paths are mixed.
    """
    listed = [given] if isinstance(given, (str, Path)) else list(given)
    read = [drive for drive in listed if isinstance(drive, Recording)]
    if read and len(read) < len(listed):
        raise ValueError("recordings and paths are mixed: load all of them, or none")
    if not read:
        read, refusals = load_recordings(_paths(listed), columns, dt, car=car)
        for refusal in refusals:
            says(f"refused: {refusal}")
        for recording in read:
            for note in doubtful(recording.notes):
                says(f"{recording.name}: {note}")
    if not read:
        raise ValueError(f"no {what} is left to look at: the lines above say why")
    return read


def names_of(given: Drives) -> list[str]:
    """Paths as texts; of recordings that were read already, their files."""
    listed = [given] if isinstance(given, (str, Path)) else given
    return [d.source or d.name if isinstance(d, Recording) else str(d) for d in listed]


def _paths(listed: Iterable[str | Path | Recording]) -> list[str | Path]:
    return [path for path in listed if not isinstance(path, Recording)]
