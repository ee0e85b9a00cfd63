"""A folder of `.npy` arrays, the format of the original study."""

from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.readers.layout import Table
from buggy_rl.recordings.recording import RecordingError

RATE = 100.0  # [Hz] assumed without time stamps: that of the original study's tracking camera

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
    """Whether a folder contains arrays."""
    return path.is_dir() and any(path.glob("*.npy"))


def read_npy_folder(path: Path, rate: float | None = None) -> Table:
    """Reads `positions`, `orientation` (w first), `linear`, `angular`, `actions`, `timestamp`.

    Nothing is unpickled.

    Args:
        path: The folder.
        rate: Rows a second [Hz], where the column map states it.

    Raises:
        RecordingError: An array is missing, pickled, cut off, or of a wrong shape or length.
    """
    arrays = {name: _load(path, name) for name in (*ARRAYS, "timestamp")}
    for name in REQUIRED:
        if arrays[name] is None:
            there = ", ".join(sorted(f.stem for f in path.glob("*.npy")))
            message = f"{name}.npy is missing; available: {there}; export one row a frame"
            raise RecordingError(str(path), message, column=name)
    table = Table(str(path), {})
    for name, channels in ARRAYS.items():
        array = arrays[name]
        if array is not None:
            width = max(channels.values()) + 1
            if array.ndim != 2 or array.shape[1] < width:
                message = f"shape {list(array.shape)}; expected [rows, {width} or more]"
                raise RecordingError(str(path), message, column=name)
            for channel, column in channels.items():
                table.columns[channel] = array[:, column]
                table.labels[channel] = f"{name}[{column}]"
    _add_time(table, arrays["timestamp"], rate)
    _check_lengths(path, arrays)
    return table


def _load(path: Path, name: str) -> ndarray | None:
    file = path / f"{name}.npy"
    if not file.exists():
        return None
    try:
        array = np.load(file, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        message = f"{name}.npy is pickled, cut off or not an array ({error}); use numpy.save"
        raise RecordingError(str(path), message, column=name) from error
    if array.dtype.kind not in "fiu":
        message = f"dtype {array.dtype} is not numeric; save plain numbers"
        raise RecordingError(str(path), message, column=name)
    return array


def _add_time(table: Table, timestamp: ndarray | None, rate: float | None) -> None:
    if timestamp is not None:
        table.columns["t"] = timestamp.reshape(-1)
        table.labels["t"] = "timestamp"
        return
    table.columns["t"] = np.arange(len(table)) / (rate or RATE)
    if rate is not None:
        return
    what = "no timestamp.npy, {rate:g} Hz assumed: if it is another, state rate in a column map"
    table.notes.append("column t: " + what.format(rate=RATE))


def _check_lengths(path: Path, arrays: dict[str, ndarray | None]) -> None:
    lengths = {name: len(array) for name, array in arrays.items() if array is not None}
    shortest = min(lengths, key=lambda name: lengths[name])
    if not lengths[shortest]:
        raise RecordingError(str(path), "no row; record again", column=shortest)
    if len(set(lengths.values())) > 1:
        message = f"shorter than the other arrays: {lengths}; export all from the same frames"
        raise RecordingError(str(path), message, lengths[shortest], shortest)
