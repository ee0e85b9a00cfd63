"""From paths to recordings; a drive that cannot be trusted does not stop the others."""

import glob
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from buggy_rl import keys
from buggy_rl.recordings.checks import check
from buggy_rl.recordings.columns import ColumnMap, load_columns
from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.errors import RecordingError, Refusal
from buggy_rl.recordings.mapping import map_columns
from buggy_rl.recordings.readers import find_drives, is_drive, read
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.resampling import resample
from buggy_rl.vehicle import CONTROL_PERIOD

Columns = ColumnMap | str | Path | None
"""A column map, the YAML file of one, or None for the standard table."""


def load_recordings(
    paths: str | Path | Sequence[str | Path],
    columns: Columns = None,
    dt: float = CONTROL_PERIOD,
    progress: Callable[[list[Path | Refusal]], Iterable[Path | Refusal]] = iter,
) -> tuple[list[Recording], list[Refusal]]:
    """Reads, checks and resamples drives.

    Args:
        paths: Files, folders (searched with what is below them) and glob patterns.
        columns: How the tables are to be read.
        dt: Control period to resample to [s].
        progress: Wraps the list of drives while they are read, e.g. `tqdm`.

    Returns:
        The drives, and those that were refused with the reason. Names are unique: drives of the
        same file name are told apart by their folders.

    Raises:
        ValueError: The column map is wrong or dt is not positive; no drive is to blame for that.
    """
    mapping = _column_map(columns)
    _check_dt(dt)
    recordings, refusals = [], []
    for found in progress(list(find_recordings(paths))):
        if isinstance(found, Refusal):
            refusals.append(found)
            continue
        try:
            recordings.append(load_recording(found, mapping, dt))
        except RecordingError as error:
            refusals.append(Refusal(str(found), error))
    _tell_apart(recordings)
    return recordings, refusals


def find_recordings(paths: str | Path | Sequence[str | Path]) -> Iterator[Path | Refusal]:
    """Drives that paths, folders and patterns stand for, each once; a refusal where none is."""
    given = [paths] if isinstance(paths, (str, Path)) else paths
    seen = set()
    for path in given:
        found = _expand(str(path))
        if not found:
            reason = "there is no drive that can be read"
            remedy = "expected .csv, .parquet, .bag, a folder of .npy or a ROS 2 bag"
            yield Refusal(str(path), RecordingError(str(path), None, None, reason, remedy))
        for drive in found:
            if drive.resolve() not in seen:
                seen.add(drive.resolve())
                yield drive


def _expand(path: str) -> list[Path]:
    """The drives that one argument stands for."""
    if Path(path).exists() or not glob.has_magic(path):
        places = [Path(path)]
    else:
        places = [Path(match) for match in sorted(glob.glob(path, recursive=True))]
        places = [place for place in places if place.is_dir() or is_drive(place)]
    found = []
    for place in places:
        found += find_drives(place) if place.is_dir() else [place]
    return found


def load_recording(
    path: str | Path, columns: Columns = None, dt: float = CONTROL_PERIOD
) -> Recording:
    """Reads, checks and resamples one drive.

    Args:
        path: A file, a folder of `.npy`, or the folder of a ROS 2 bag.
        columns: How the table is to be read.
        dt: Control period to resample to [s].

    Raises:
        RecordingError: The drive cannot be trusted; the message names file, row and column.
        ValueError: The column map is wrong or dt is not positive.
    """
    mapping = _column_map(columns)
    _check_dt(dt)
    path = Path(path)
    drive = map_columns(read(path, mapping.topics), mapping)
    check(drive, mapping.limits)
    arrays = resample(drive, mapping, dt)
    return Recording(_name(path), _data(drive, arrays), dt, str(path), drive.notes)


def _column_map(columns: Columns) -> ColumnMap:
    if columns is None:
        return ColumnMap()
    return columns if isinstance(columns, ColumnMap) else load_columns(columns)


def _check_dt(dt: float) -> None:
    if not 0 < dt <= 0.1:
        raise ValueError(f"dt is {dt} s, expected more than 0 and at most 0.1: 0.01 is usual")


def _name(path: Path) -> str:
    return path.name if path.is_dir() else path.stem


def _data(drive: Drive, arrays: dict[str, np.ndarray]) -> TensorDict:
    if not arrays:
        raise drive.refusal(
            *(0, "t", f"no stretch is long enough to use ({drive.notes[-1]})"), "record again"
        )
    single = (keys.POSE, keys.VELOCITY, keys.ACTION)
    tensors = {
        key: torch.from_numpy(values.astype(np.float32) if key in single else values)
        for key, values in arrays.items()
    }
    return TensorDict(tensors, batch_size=[len(arrays[keys.TIME])])


def _tell_apart(recordings: list[Recording]) -> None:
    """Puts folders before names that occur twice, as many as it takes."""
    for depth in range(1, 10):
        count = Counter(recording.name for recording in recordings)
        doubles = [recording for recording in recordings if count[recording.name] > 1]
        for recording in doubles:
            path = Path(recording.source).resolve()
            above = path.parts[-1 - depth : -1]
            recording.name = "/".join([*above, _name(path)])
