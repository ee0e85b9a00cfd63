"""Readers, one for each kind of file; all return a `Table`."""

from pathlib import Path

from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.readers.bag import files_alone, is_bag, read_bag
from buggy_rl.recordings.readers.interleaved import TABLES, holds_tables, read_several
from buggy_rl.recordings.readers.layout import Table
from buggy_rl.recordings.readers.npy import is_npy_folder, read_npy_folder
from buggy_rl.recordings.recording import RecordingError

__all__ = ["Table", "is_recording", "read", "recordings_below"]


def is_recording(path: Path) -> bool:
    """Whether a reader takes this file or folder."""
    if path.is_dir():
        return is_npy_folder(path) or is_bag(path)
    return path.suffix.lower() in TABLES or is_bag(path)


def recordings_below(folder: Path, columns: ColumnMap) -> list[Path]:
    """Recordings in a folder and below, sorted; hidden files and folders are skipped."""
    if is_recording(folder) or holds_tables(folder, columns.tables):
        return [folder]
    found = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            found += recordings_below(entry, columns)
        elif is_recording(entry):
            found.append(entry)
    return found


def read(path: Path, columns: ColumnMap) -> Table:
    """Reads a recording unconverted and unchecked.

    Raises:
        RecordingError: There is no such file, or it cannot be read.
    """
    if not path.exists():
        raise RecordingError(str(path), "no such file; correct the path")
    if columns.tables and path.is_dir():
        return read_several(path, columns)
    if is_bag(path) or files_alone(path):
        return read_bag(path, columns)
    if path.is_dir():
        return read_npy_folder(path, columns.rate)
    if path.suffix.lower() in TABLES:
        return TABLES[path.suffix.lower()](path)
    message = f"ending {path.suffix!r} is not supported; use .csv, .parquet, .jsonl, .bag, .mcap, "
    raise RecordingError(str(path), message + ".db3, a folder of .npy or of a ROS 2 bag")
