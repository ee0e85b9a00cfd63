"""CSV and Parquet."""

import io
import re
import warnings
from pathlib import Path
from typing import Any

import pandas as pd

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.table import Table

SEPARATORS = ",;\t"
# Before 3.1 pandas rounds the last bit unless told not to; from then on it is exact by itself.
OLD_PANDAS = tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1)
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if OLD_PANDAS else {}


def read_csv(path: Path) -> Table:
    """Reads a CSV file; an unfinished last line is left out with a note.

    Raises:
        RecordingError: The file is empty or not text, or a line has too many cells.
    """
    file = str(path)
    content = path.read_bytes()
    if not content.strip():
        raise RecordingError(file, "the file is empty; record again")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        message = f"not UTF-8 text ({error.reason}); save it as UTF-8 text"
        raise RecordingError(file, message) from error
    header = text.lstrip().split("\n", 1)[0]
    separator = max(SEPARATORS, key=header.count)
    table = _table(file, _parse(text, separator, file))
    unfinished = _unfinished(text, header.count(separator) + 1, separator)
    if unfinished and len(table):
        row = len(table) - 1
        table.columns = {name: values[:-1] for name, values in table.columns.items()}
        table.notes.append(f"row {row}, column {list(table.columns)[-1]}: {unfinished}: cut")
    return _not_empty(table)


def _parse(text: str, separator: str, file: str) -> pd.DataFrame:
    options: dict[str, Any] = {"sep": separator, "index_col": False, "skipinitialspace": True}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(io.StringIO(text), **options, **EXACT)
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        line = re.search(r"line (\d+)", str(error))  # counted from 1, the header included
        message = f"more cells than the header ({error}); delete the line or complete the header"
        raise RecordingError(file, message, int(line[1]) - 2 if line else None) from error


def _unfinished(text: str, cells: int, separator: str) -> str:
    """Why the last line is invalid; empty if it is valid."""
    found = text.rstrip("\r\n").rsplit("\n", 1)[-1].count(separator) + 1
    if found < cells or (text.endswith("\n") and found > cells):
        return f"the file is cut off ({found} of {cells} cells)"
    if text.endswith("\n"):
        return ""
    return "the file ends without a line end, so its last number may be cut off"


def read_parquet(path: Path) -> Table:
    """Reads a Parquet file.

    Raises:
        RecordingError: The file is empty, cut off or not Parquet.
    """
    file = str(path)
    if not path.stat().st_size:
        raise RecordingError(file, "the file is empty; record again")
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:  # pyarrow's own errors derive from these
        message = f"cut off or not Parquet ({error}); export it again"
        raise RecordingError(file, message) from error
    return _not_empty(_table(file, frame))


def _table(file: str, frame: pd.DataFrame) -> Table:
    columns = {str(name).strip(): frame[name].to_numpy() for name in frame.columns}
    return Table(file, columns)


def _not_empty(table: Table) -> Table:
    if not len(table):
        raise RecordingError(table.file, "a header but no row; record again")
    return table
