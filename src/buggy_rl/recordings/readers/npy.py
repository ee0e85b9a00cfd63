"""A folder of `.npy` arrays, as the original study kept its drives."""

from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.table import Table

RATE = 100.0  # [Hz] of the original study's tracking camera, when there are no time stamps

ARRAYS: dict[str, dict[str, int]] = {
    "positions": {"x": 0, "y": 1},
    "orientation": {"qw": 0, "qx": 1, "qy": 2, "qz": 3},
    "linear": {"vx": 0, "vy": 1},
    "angular": {"yaw_rate": 2},
    "actions": {"throttle": 0, "steering": 1},
}
"""Array -> channel -> its column."""

REQUIRED = ("positions", "orientation", "actions")


def is_npy_folder(path: Path) -> bool:
    """Whether a folder holds arrays itself."""
    return path.is_dir() and any(path.glob("*.npy"))


def read_npy_folder(path: Path) -> Table:
    """Reads `positions`, `orientation` (w first), `linear`, `angular`, `actions`, `timestamp`.

    Nothing is ever unpickled.

    Raises:
        RecordingError: An array is missing, pickled, cut off, or of another shape or length.
    """
    arrays = {name: _load(path, name) for name in (*ARRAYS, "timestamp")}
    for name in REQUIRED:
        if arrays[name] is None:
            there = ", ".join(sorted(f.stem for f in path.glob("*.npy")))
            raise RecordingError(
                *(str(path), None, name, f"{name}.npy is missing; there are: {there}"),
                f"export it, one row a frame, beside {', '.join(REQUIRED)}",
            )
    table = Table(str(path), {})
    for name, channels in ARRAYS.items():
        array = arrays[name]
        if array is not None:
            _check_shape(path, name, array, max(channels.values()) + 1)
            for channel, column in channels.items():
                table.columns[channel] = array[:, column]
                table.labels[channel] = f"{name}[{column}]"
    _add_time(table, arrays["timestamp"])
    _check_lengths(path, arrays)
    return table


def _load(path: Path, name: str) -> ndarray | None:
    file = path / f"{name}.npy"
    if not file.exists():
        return None
    try:
        array = np.load(file, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise RecordingError(
            *(str(path), None, name, f"{name}.npy is pickled, cut off or no array ({error})"),
            "save plain numbers with numpy.save",
        ) from error
    if array.dtype.kind not in "fiu":
        raise RecordingError(
            str(path), None, name, f"it holds {array.dtype}, no numbers", "save plain numbers"
        )
    return array


def _check_shape(path: Path, name: str, array: ndarray, width: int) -> None:
    if array.ndim != 2 or array.shape[1] < width:
        raise RecordingError(
            *(str(path), None, name, f"its shape is {list(array.shape)}"),
            f"expected [rows, {width} or more]",
        )


def _add_time(table: Table, timestamp: ndarray | None) -> None:
    if timestamp is not None:
        table.columns["t"] = timestamp.reshape(-1)
        table.labels["t"] = "timestamp"
        return
    table.columns["t"] = np.arange(len(table)) / RATE
    table.notes.append(f"column 't': there is no timestamp.npy, {RATE:g} Hz assumed")


def _check_lengths(path: Path, arrays: dict[str, ndarray | None]) -> None:
    lengths = {name: len(array) for name, array in arrays.items() if array is not None}
    shortest = min(lengths, key=lambda name: lengths[name])
    if not lengths[shortest]:
        raise RecordingError(str(path), None, shortest, "it has no row", "record again")
    if len(set(lengths.values())) > 1:
        raise RecordingError(
            *(str(path), lengths[shortest], shortest, f"it ends before the others: {lengths}"),
            "export all arrays from the same frames",
        )
