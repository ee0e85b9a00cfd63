"""Writing a recording as a standard table."""

import os
import tempfile
from pathlib import Path

import pandas as pd

from buggy_rl import keys
from buggy_rl.recordings.recording import Recording

COLUMNS = {
    keys.POSE: ("x", "y", "yaw"),
    keys.VELOCITY: ("vx", "vy", "yaw_rate"),
    keys.ACTION: ("throttle", "steering"),
}


def save_recording(recording: Recording, path: str | Path) -> None:
    """Writes a drive as CSV or Parquet with the columns of the standard table.

    Reading it back gives the same numbers: t to float64, the others to float32. Segments are
    told by the rows that are missing between them. The file appears at once or not at all.

    Args:
        recording: The drive.
        path: Ending in `.csv` or `.parquet`; a file that is there is replaced.

    Raises:
        ValueError: The ending is another one.
    """
    path = Path(path)
    if path.suffix not in (".csv", ".parquet"):
        raise ValueError(f"{path}: cannot write {path.suffix!r}, use .csv or .parquet")
    frame = _frame(recording)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    os.close(handle)
    try:
        if path.suffix == ".csv":
            frame.to_csv(name, index=False)
        else:
            frame.to_parquet(name, index=False)
        _flush(name)
        os.chmod(name, 0o666 & ~_umask())  # mkstemp's files are private
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def _flush(name: str) -> None:
    """Puts the file on the disk before its name: a power cut leaves the old or the new one."""
    with open(name, "rb") as file:
        os.fsync(file.fileno())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _frame(recording: Recording) -> pd.DataFrame:
    frame = {"t": recording.data[keys.TIME][:, 0].cpu().numpy()}
    for key, names in COLUMNS.items():
        values = recording.data[key].cpu().numpy()
        frame |= {name: values[:, column] for column, name in enumerate(names)}
    return pd.DataFrame(frame)
