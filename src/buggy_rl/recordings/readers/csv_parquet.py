"""CSV and Parquet."""

import io
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from buggy_rl.extras import needs
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.layout import SPACES, Layout, cells, layout
from buggy_rl.recordings.readers.table import Table
from buggy_rl.recordings.readers.text import decoded

# Before 3.1 pandas rounds the last bit unless told not to; from then on it is exact by itself.
OLD_PANDAS = tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1)
EXACT: dict[str, Any] = {"float_precision": "round_trip"} if OLD_PANDAS else {}
COMMA = re.compile(r"[+-]?\d*,?\d+([eE][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+")


def read_csv(path: Path) -> Table:
    """Reads a table in text; an unfinished last line is left out with a note.

    Raises:
        RecordingError: The file is empty or not text, or a line has too many cells.
    """
    file = str(path)
    content = path.read_bytes()
    if not content.strip(b" \t\r\n\0"):
        raise RecordingError(file, "the file is empty; record again")
    text = decoded(content, file)
    found = layout(text, file)
    frame = _with_points(_parse(found, file))
    table = _table(file, frame)
    table.notes += found.notes
    table.headerless = not found.header
    if len(found.rows) == len(table):  # not so where a quoted cell has a line end in it
        table.rows = found.rows
        table.starts = np.array(found.starts, int)
    if table.headerless:
        last = len(frame.columns) - 1
        table.notes.append(f"no header line: columns are named by their position, 0 to {last}")
    unfinished = _unfinished(text, found)
    if unfinished and len(table):
        row = int(table.file_rows[-1])
        table = table.take(np.arange(len(table) - 1))
        table.notes.append(f"row {row}, column {list(table.columns)[-1]}: {unfinished}: cut")
    return _not_empty(table)


def _parse(found: Layout, file: str) -> pd.DataFrame:
    text = "\n".join([*([found.header] if found.header else []), *found.lines])
    options: dict[str, Any] = {"sep": found.separator, "index_col": False, "skipinitialspace": True}
    if not found.header:
        width = len(cells(found.lines[0], found.separator))
        options |= {"header": None, "names": [str(i) for i in range(width)]}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(io.StringIO(text), **options, **EXACT)
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        row = _row_of(str(error), found)
        message = f"more cells than the header ({error}); delete the line or complete the header"
        raise RecordingError(file, message, row) from error


def _row_of(error: str, found: Layout) -> int | None:
    """Row of the file that a message of pandas names, which counts lines from 1."""
    line = re.search(r"line (\d+)", error)
    if line is None:
        return None
    index = int(line[1]) - (2 if found.header else 1)
    return int(found.rows[index]) if 0 <= index < len(found.rows) else None


def _with_points(frame: pd.DataFrame) -> pd.DataFrame:
    """Columns whose decimals are written with a comma, as numbers.

    Not where commas may group thousands: where other columns have a decimal point.
    """
    pointed = any(
        pd.api.types.is_float_dtype(values) and (values % 1 > 0).any()
        for _, values in frame.items()
    )
    changed = {}
    for name, values in frame.items():
        if pd.api.types.is_numeric_dtype(values):
            continue
        known = values.notna().to_numpy()
        text = [str(cell).strip() for cell in values[known]]
        if not all(COMMA.fullmatch(cell) for cell in text):
            continue
        if pointed and all(THOUSANDS.fullmatch(cell) for cell in text if "," in cell):
            continue
        numbers = np.full(len(values), np.nan)
        numbers[known] = [float(cell.replace(",", ".")) for cell in text]
        changed[name] = numbers
    return frame.assign(**changed) if changed else frame


def _unfinished(text: str, found: Layout) -> str:
    """Why the last line is invalid; empty if it is valid."""
    if not found.lines:
        return ""
    wanted = len(cells(found.header or found.lines[0], found.separator))
    last = text.rstrip("\r\n").replace("\r", "\n").rsplit("\n", 1)[-1]
    ended = text.endswith(("\n", "\r"))
    there = len(cells(last, found.separator))
    if last.strip() == found.lines[-1].strip() and (
        there < wanted or (ended and there > wanted and found.separator != SPACES)
    ):
        return f"the file is cut off ({there} of {wanted} cells)"
    if ended or last.strip() != found.lines[-1].strip():
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
    needs("pyarrow", "bags", f"reading {path}")
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:  # pyarrow's own errors derive from these
        message = f"cut off or not Parquet ({error}); export it again"
        raise RecordingError(file, message) from error
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()  # pandas writes stamps that are an index this way
    return _not_empty(_table(file, frame))


def _table(file: str, frame: pd.DataFrame) -> Table:
    return Table(file, {str(name).strip(): _array(values) for name, values in frame.items()})


def _array(values: pd.Series) -> np.ndarray:
    """A column; dates with a zone are those of UTC."""
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        return values.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy()
    return values.to_numpy()


def _not_empty(table: Table) -> Table:
    if not len(table):
        raise RecordingError(table.file, "a header but no row; record again")
    return table
