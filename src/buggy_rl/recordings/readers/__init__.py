"""Readers: one kind of file each, all to a `Table`; and what of a folder is a drive."""

from pathlib import Path

from buggy_rl.recordings.columns import Topics
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.bag import is_bag, read_bag
from buggy_rl.recordings.readers.npy import is_npy_folder, read_npy_folder
from buggy_rl.recordings.readers.table import Table
from buggy_rl.recordings.readers.tables import TABLE_ENDINGS, read_csv, read_parquet

__all__ = ["Table", "find_drives", "is_drive", "read"]


def is_drive(path: Path) -> bool:
    """Whether one of the readers takes this file or folder for a drive."""
    if path.is_dir():
        return is_npy_folder(path) or is_bag(path)
    return path.suffix.lower() in TABLE_ENDINGS or is_bag(path)


def find_drives(folder: Path) -> list[Path]:
    """Drives in a folder and below, sorted; a drive that is a folder is not searched further."""
    if is_drive(folder):
        return [folder]
    found = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue  # hidden: a half-written temporary file, or a version control folder
        if entry.is_dir():
            found += find_drives(entry)
        elif is_drive(entry):
            found.append(entry)
    return found


def read(path: Path, topics: Topics) -> Table:
    """Reads a drive as it stands, without judging it.

    Raises:
        RecordingError: There is no such file, or it cannot be read.
    """
    if not path.exists():
        raise RecordingError(str(path), None, None, "there is no such file", "correct the path")
    if is_bag(path):
        return read_bag(path, topics)
    if path.is_dir():
        return read_npy_folder(path)
    if path.suffix.lower() == ".csv":
        return read_csv(path)
    if path.suffix.lower() == ".parquet":
        return read_parquet(path)
    raise RecordingError(
        *(str(path), None, None, f"the ending {path.suffix!r} is not read"),
        "use .csv, .parquet, .bag, a folder of .npy, or a ROS 2 bag folder",
    )
