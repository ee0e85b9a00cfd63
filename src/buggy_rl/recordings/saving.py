"""Writing a recording as a standard table, at once or row by row."""

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import pandas as pd
import yaml

from buggy_rl.core import keys
from buggy_rl.core.extras import needs
from buggy_rl.core.files import replacing, write_atomically
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.recordings.columns import BESIDE
from buggy_rl.recordings.recording import Recording

COLUMNS = {
    keys.POSE: ("x", "y", "yaw"),
    keys.VELOCITY: ("vx", "vy", "yaw_rate"),
    keys.ACTION: ("throttle", "steering"),
}
"""Key -> columns of the standard table."""


def save_recording(recording: Recording, path: str | Path) -> None:
    """Writes a recording as CSV or Parquet with the columns of the standard table, atomically.

    Reading it back gives the same numbers: t as float64, the others as float32. The missing rows
    between segments mark the gaps. An existing file is replaced.

    Raises:
        ValueError: The path does not end in `.csv` or `.parquet`.
    """
    path = Path(path)
    if path.suffix not in (".csv", ".parquet"):
        raise ValueError(f"{path}: cannot write {path.suffix!r}; use .csv or .parquet")
    if path.suffix == ".parquet":
        needs("pyarrow", "bags", f"writing {path}")
    frame = pd.DataFrame({"t": recording.data[keys.TIME][:, 0].cpu().numpy()})
    beside = {key: (key,) for key in BESIDE if key in recording.data.keys()}  # noqa: SIM118
    for key, names in {**COLUMNS, **beside}.items():
        frame[list(names)] = recording.data[key].cpu().numpy()
    with replacing(path) as partial:
        if path.suffix == ".csv":
            frame.to_csv(partial, index=False)
        else:
            frame.to_parquet(partial, index=False)
        with partial.open("rb") as file:
            os.fsync(file.fileno())  # the content is on the disk before the name


def save_command(command: LongitudinalCommand, path: str | Path) -> None:
    """Writes the column map with which recordings of a car with this command are read back."""
    write_atomically(Path(path), yaml.safe_dump({"command": command.plain_fields}))


HEADER = ("t", *(name for names in COLUMNS.values() for name in names))


class Recorder:
    """Appends rows to a CSV file that `load_recordings` reads, whatever happens in between.

    Every row is handed to the operating system at once: a process that is killed loses at most the
    row that it was writing. A row that is cut off is left out by the reader, with a note.

    Args:
        path: A new file ending in `.csv`; its folder is made.

    Raises:
        ValueError: The ending is another one, or the file exists.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix != ".csv":
            raise ValueError(f"{path}: a drive is recorded as .csv; name the file so")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = self.path.open("x", buffering=1, newline="")  # 1: line by line
        except FileExistsError:
            free = next_free(self.path)
            raise ValueError(f"{path} exists and is kept: record to {free} instead") from None
        self._file.write(",".join(HEADER) + "\n")
        self.rows = 0

    def write(self, t: float, values: Sequence[float]) -> None:
        """Appends a row: time [s], then pose, velocity and action [8], as `HEADER` names them."""
        if len(values) + 1 != len(HEADER):
            raise ValueError(f"{len(values)} values for the columns {', '.join(HEADER[1:])}")
        self._file.write(",".join(map(repr, (float(t), *map(float, values)))) + "\n")
        self.rows += 1

    def __enter__(self) -> "Recorder":
        """The recorder itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Brings the rows to the disk and closes the file; one without rows is taken away."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        if not self.rows:
            self.path.unlink()


def next_free(path: Path) -> Path:
    """The first of NAME_0, NAME_1, ... beside a file that does not exist."""
    name, _, number = path.stem.rpartition("_")
    stem = name if name and number.isdigit() else path.stem
    index = 0
    while (free := path.with_name(f"{stem}_{index}{path.suffix}")).exists():
        index += 1
    return free
