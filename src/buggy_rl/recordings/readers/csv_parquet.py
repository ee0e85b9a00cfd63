"""CSV, Parquet and JSON Lines, from bytes to columns."""

import codecs
import io
import json
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from buggy_rl.core.extras import needs
from buggy_rl.recordings.readers.layout import SPACES, Table, TableLayout, cells, layout
from buggy_rl.recordings.recording import RecordingError

MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # begins with that of UTF-16, so it is tried before
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order mark -> encoding."""
TRIED = ("utf-8", "cp1252", "latin-1")
"""Encodings without a mark, in order; Latin-1 decodes any bytes."""
SAMPLE = 4096  # [bytes] looked at for UTF-16 without a mark
HALF_ZERO = 0.7  # share of zero bytes at even or odd places that UTF-16 of plain text has; chosen
# Tab, line ends, form feed, the end of file of DOS, and zero bytes, which are told line by line.
BINARY = re.compile(r"[\x01-\x08\x0b\x0e-\x19\x1b-\x1f]")


def decoded(content: bytes, file: str) -> str:
    """The text of a file in UTF-8, UTF-16, UTF-32, Windows-1252 or Latin-1.

    Raises:
        RecordingError: It is not text.
    """
    for encoding in _encodings(content):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if BINARY.search(text):
            break
        return text.rstrip("\x1a")
    message = "not text in UTF-8, UTF-16 or Latin-1; save it as UTF-8 text"
    raise RecordingError(file, message)


def _encodings(content: bytes) -> tuple[str, ...]:
    for mark, encoding in MARKS:
        if content.startswith(mark):
            return (encoding,)
    sample = content[:SAMPLE]
    even, odd = (part.count(0) / max(len(part), 1) for part in (sample[0::2], sample[1::2]))
    if odd > HALF_ZERO > even:
        return ("utf-16-le",)
    if even > HALF_ZERO > odd:
        return ("utf-16-be",)
    return TRIED


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


def _parse(found: TableLayout, file: str) -> pd.DataFrame:
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


def _row_of(error: str, found: TableLayout) -> int | None:
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
    changed: dict[str, Any] = {}
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
        changed[str(name)] = numbers
    return frame.assign(**changed) if changed else frame


def _unfinished(text: str, found: TableLayout) -> str:
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


def read_json_lines(path: Path) -> Table:
    """Reads a file of one JSON object a line; an unfinished last line is left out with a note.

    Objects within an object are columns `pose.x`, elements of a list `axes[0]`. Lines may hold
    different keys, e.g. those of several topics: a key that a line lacks has no value there.

    Raises:
        RecordingError: The file is empty or not text, or a line is no JSON object.
    """
    file = str(path)
    content = path.read_bytes()
    if not content.strip(b" \t\r\n\0"):
        raise RecordingError(file, "the file is empty; record again")
    lines = decoded(content, file).splitlines()
    told = [(row, line) for row, line in enumerate(lines) if line.strip(" \t\0")]
    records, rows, notes = [], [], []
    for row, line in told:
        try:
            record = json.loads(line)
        except json.JSONDecodeError as error:
            if row == told[-1][0]:
                notes.append(f"row {row}, all columns: the file is cut off ({error.msg}): cut")
                break
            if "\0" in line:
                notes.append(f"row {row}: zero bytes, as a power cut leaves them: cut")
                continue
            message = f"not JSON ({error.msg}, character {error.pos}); delete the line"
            raise RecordingError(file, message, row) from error
        if not isinstance(record, dict):
            message = f"{line.strip()[:40]} is no object; write one object a line: {{'t': 0.0}}"
            raise RecordingError(file, message.replace("'", '"'), row)
        records.append(dict(_flat(record)))
        rows.append(row)
    if not records:
        raise RecordingError(file, "no complete line; record again")
    frame = pd.DataFrame.from_records(records)
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    return Table(file, columns, notes=notes, rows=np.array(rows, int))


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Names and plain values of what is within a value."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _flat(inner, f"{name}[{index}]")
    else:
        yield name, value
