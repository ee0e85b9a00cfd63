"""Writing a recording as a standard table."""

import os
from pathlib import Path

import pandas as pd
import yaml

from buggy_rl import keys
from buggy_rl.extras import needs
from buggy_rl.files import replacing, write_atomically
from buggy_rl.longitudinal import LongitudinalCommand
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
