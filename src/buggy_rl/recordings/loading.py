"""Loads recordings from paths; a refused recording does not stop the others."""

import glob
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.recordings.checks import CHECKS
from buggy_rl.recordings.columns import BESIDE, ColumnMap, load_columns
from buggy_rl.recordings.mapping import map_columns
from buggy_rl.recordings.readers import is_recording, read, recordings_below
from buggy_rl.recordings.recording import Recording, RecordingError
from buggy_rl.recordings.resampling import resample
from buggy_rl.recordings.stamps import place_in_session

LONGEST_PERIOD = 0.1  # [s] of the control; a steering lag of 0.1 s is not resolved above it
DEEPEST = 10  # folders that a name may take to be unique; chosen

Columns = ColumnMap | str | Path | None
"""A column map, its YAML file, or None for the standard table."""

Found = Path | RecordingError
"""A recording's path, or why there is none."""


def load_recordings(
    paths: str | Path | Sequence[str | Path],
    columns: Columns = None,
    dt: float = CONTROL_PERIOD,
    progress: Callable[[list[Found]], Iterable[Found]] = iter,
    car: str = "",
) -> tuple[list[Recording], list[RecordingError]]:
    """Reads, checks and resamples recordings.

    Args:
        paths: Files, folders (searched recursively) and glob patterns.
        columns: How the tables are read.
        dt: Control period to resample to [s].
        progress: Wraps the list of recordings while they are read, e.g. `tqdm`.
        car: Name or file of the car, whose limits hold where the column map states none.

    Returns:
        The recordings, and the errors of those that were refused. Names are unique: folders are
        put before the names of files that have the same name.

    Raises:
        ValueError: The column map or dt is wrong.
    """
    mapping = _checked(columns, dt, car)
    recordings, refusals = [], []
    for found in progress(list(_find(paths, mapping))):
        try:
            if isinstance(found, RecordingError):
                raise found
            recordings.append(_load(found, mapping, dt))
        except RecordingError as error:
            refusals.append(error)
    _make_unique(recordings)
    place_in_session(recordings)
    return recordings, refusals


def load_recording(
    path: str | Path, columns: Columns = None, dt: float = CONTROL_PERIOD, car: str = ""
) -> Recording:
    """Reads, checks and resamples one recording.

    Args:
        path: A file, a folder of `.npy`, or the folder of a ROS 2 bag.
        columns: How the table is read.
        dt: Control period to resample to [s].
        car: Name or file of the car, whose limits hold where the column map states none.

    Raises:
        RecordingError: The recording is refused; the message names file, row and column.
        ValueError: The column map or dt is wrong.
    """
    return _load(Path(path), _checked(columns, dt, car), dt)


def _checked(columns: Columns, dt: float, car: str) -> ColumnMap:
    if not 0 < dt <= LONGEST_PERIOD:
        raise ValueError(f"dt is {dt} s; use more than 0 and at most {LONGEST_PERIOD}, e.g. 0.01")
    if not isinstance(columns, ColumnMap):
        columns = ColumnMap() if columns is None else load_columns(columns)
    if not car:
        return columns
    known = load_car(car)
    command = known.command if columns.command == ONE_WAY else columns.command
    return replace(columns, limits=columns.limits.for_car(known), command=command)


def _find(paths: str | Path | Sequence[str | Path], columns: ColumnMap) -> Iterator[Found]:
    """Recordings of paths, folders and patterns, each once; an error where there is none."""
    seen = set()
    for path in [paths] if isinstance(paths, (str, Path)) else paths:
        found = _expand(str(path), columns)
        if not found:
            message = (
                "none found; expected .csv, .parquet, .jsonl, .bag, a folder of .npy or a ROS 2 bag"
            )
            yield RecordingError(str(path), message)
        for recording in found:
            if recording.resolve() not in seen:
                seen.add(recording.resolve())
                yield recording


def _expand(path: str, columns: ColumnMap) -> list[Path]:
    """The recordings of one argument."""
    if Path(path).exists() or not glob.has_magic(path):
        matches = [Path(path)]
    else:
        matches = [Path(match) for match in sorted(glob.glob(_pattern(path), recursive=True))]
        matches = [match for match in matches if match.is_dir() or is_recording(match)]
    found = []
    for match in matches:
        found += recordings_below(match, columns) if match.is_dir() else [match]
    return found


def _pattern(path: str) -> str:
    """A glob pattern in which folders that are there stand for themselves, brackets and all."""
    parts, known = Path(path).parts, 0
    while known < len(parts) and Path(*parts[: known + 1]).is_dir():
        known += 1
    return str(Path(glob.escape(str(Path(*parts[:known]))), *parts[known:]))


def _load(path: Path, columns: ColumnMap, dt: float) -> Recording:
    raw = map_columns(read(path, columns), columns)
    for check in CHECKS:
        check(raw, columns.limits)
    arrays = resample(raw, columns, dt)
    if not arrays:
        raise raw.error(0, "t", f"no segment is long enough ({raw.notes[-1]}); record again")
    single = (keys.POSE, keys.VELOCITY, keys.ACTION, *BESIDE)
    tensors = {
        key: torch.from_numpy(values.astype(np.float32) if key in single else values)
        for key, values in arrays.items()
    }
    data = TensorDict(tensors, batch_size=[len(arrays[keys.TIME])])
    return Recording(
        _name(path),
        data,
        dt,
        str(path),
        raw.notes,
        columns.command,
        derived=raw.derived,
    )


def _name(path: Path) -> str:
    return path.name if path.is_dir() else path.stem


def _make_unique(recordings: list[Recording]) -> None:
    """Puts folders before equal names, as many as needed."""
    for depth in range(1, DEEPEST):
        count = Counter(recording.name for recording in recordings)
        for recording in [r for r in recordings if count[r.name] > 1]:
            path = Path(recording.source).resolve()
            recording.name = "/".join([*path.parts[-1 - depth : -1], _name(path)])


QUIET = (
    "derived from the pose",
    "positions count from",
    ": counted from",
    ": dropped",
    "are read as",
)
"""Parts of the notes that say how a sound recording was read; all others say what to look at."""
DOUBTFUL = (" if ", " assumed", "the clock was set", "held for up to", "the commands stop", "s old")
"""Parts of the notes that say that the recording may not be what it seems."""


def telling(notes: Iterable[str]) -> list[str]:
    """The notes that say what was cut, held, assumed or looks wrong: for a check of recordings."""
    return [note for note in notes if not any(part in note for part in QUIET)]


def doubtful(notes: Iterable[str]) -> list[str]:
    """The notes that say what may be wrong with the whole recording: for all that use it."""
    return [note for note in telling(notes) if any(part in note for part in DOUBTFUL)]
