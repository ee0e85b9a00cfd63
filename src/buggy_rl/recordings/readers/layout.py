"""The layout of a table in text: comments, separator, header, and which lines are rows."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy import ndarray

from buggy_rl.recordings.recording import RecordingError

SEPARATORS = "\t;|,"
SPACES = r"\s+"
COMMENT = re.compile(r"\s*(#|%|//)")
STATED = re.compile(r'"?sep=(.)"?\s*$', re.IGNORECASE)  # a first line that spreadsheets write
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d|\d\d?[.:]\d\d[.:]\d\d")
SAMPLE = 40  # lines that the separator is chosen by
PREAMBLE = 100  # lines within which the first row is looked for; exports of motion capture have 7


@dataclass
class TableLayout:
    """Separator, header and lines of the rows of a table in text."""

    separator: str
    header: str
    """The line of the names; empty where there is none."""
    lines: list[str]
    """The lines of the rows."""
    rows: ndarray
    """Row of the file of each, counted from 0 below the header, every line of the file counted."""
    starts: list[int] = field(default_factory=list)
    """Indices of `lines` at which the header stood again: there another file begins."""
    notes: list[str] = field(default_factory=list)


def layout(text: str, file: str) -> TableLayout:
    """Finds the rows of a table.

    The header is, of the lines before the first row that have as many cells, the one with the most
    different names; lines of comments (`#`, `%`, `//`), of units and of an export's preamble are
    left out, and so are lines with zero bytes, which a power cut leaves.

    Raises:
        RecordingError: The line of the names has zero bytes.
    """
    lines = re.split(r"\r\n|\n|\r", text)
    first = next((i for i, line in enumerate(lines) if line.strip(" \t\0")), 0)
    stated = STATED.match(lines[first].lstrip("\ufeff"))
    begin = first + 1 if stated else first
    separator = stated[1] if stated else _separator(lines[begin:])
    head, top = _header(lines, begin, separator)
    if head is not None and "\0" in lines[head]:
        message = "zero bytes in the line of the names; write the names into it again"
        raise RecordingError(file, message, 0)
    header = "" if head is None else _uncommented(lines[head], separator)
    below = top if head is None else head + 1
    found = TableLayout(separator, header, [], np.empty(0, int))
    found.rows = _select(lines, found, below, top, None if head is None else lines[head])
    return found


def cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without quotes and spaces around them."""
    if separator == SPACES:
        return line.split()
    row = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return [cell.strip() for cell in row]


def is_row(found: Sequence[str]) -> bool:
    """Whether cells are a row and not names: half of those that are not empty are numbers.

    Names may be numbers, too: 0, 1, 2 and so on, as a table without names has them.
    """
    told = [cell for cell in found if cell]
    numbers = sum(_is_number(cell) for cell in told)
    if told == [str(i) for i in range(len(told))]:
        return False
    alone = numbers == len(told) and len(found) > 1  # what an outer join has in a row
    return alone or (numbers >= min(2, len(found)) and 2 * numbers >= len(told))


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell) or DATE.match(cell))


def _separator(lines: Sequence[str]) -> str:
    """Separator that makes the most numbers of the first lines; without any, that of the header."""
    sample = [line for line in lines[:PREAMBLE] if line.strip() and "\0" not in line]
    rows = [line for line in sample if not COMMENT.match(line)][-SAMPLE:]
    if not rows:
        return ","
    score = {
        separator: sum(_is_number(cell) for line in rows for cell in cells(line, separator))
        for separator in (*SEPARATORS, SPACES)
    }
    best = max(score, key=lambda separator: score[separator])
    if not score[best] or (best == SPACES and not _spaced(rows)):
        return max(",;\t", key=sample[0].count)
    return best


def _spaced(rows: Sequence[str]) -> bool:
    return len({len(row.split()) for row in rows}) == 1 and len(rows[0].split()) > 1


def _header(lines: Sequence[str], begin: int, separator: str) -> tuple[int | None, int]:
    """The line of the names, None where there is none, and the first row."""
    told = [i for i in range(begin, min(len(lines), begin + PREAMBLE)) if lines[i].strip(" \t\0")]
    plain = [i for i in told if not COMMENT.match(lines[i])]
    row = next((i for i in plain if is_row(cells(lines[i], separator))), None)
    if row is None:  # text alone: the first line, as a table without rows has it
        return (plain[0], plain[0] + 1) if plain else (begin, begin + 1)
    width = len(cells(lines[row], separator))
    names = {i: cells(_uncommented(lines[i], separator), separator) for i in told if i < row}
    fitting = [i for i, found in names.items() if len(found) == width and not is_row(found)]
    if not fitting:  # a header of another length is refused as such, by its row
        before = [i for i in plain if i < row]
        return (before[-1], row) if before else (None, row)
    return max(fitting, key=lambda i: len({cell for cell in names[i] if cell})), row


def _uncommented(line: str, separator: str) -> str:
    """A line of names without the sign of a comment before them."""
    sign = COMMENT.match(line)
    return line[sign.end() :].strip(" ") if sign else line


def _select(
    lines: Sequence[str], found: TableLayout, below: int, first: int, header: str | None
) -> ndarray:
    """Fills in the lines of the rows; returns their rows in the file."""
    rows, zeros, comments = [], [], 0
    text = [i - below for i in range(below, first) if lines[i].strip()]
    for at in range(first, len(lines)):
        line = lines[at]
        if "\0" in line:
            zeros.append((at - below, line.count("\0")))
        elif header is not None and line.strip() == header.strip():
            found.starts.append(len(rows))
            found.notes.append(f"row {at - below}: the header again, two files joined: cut there")
        elif COMMENT.match(line):
            comments += 1
        elif line.strip():
            found.lines.append(line)
            rows.append(at - below)
    if text:
        found.notes.append(f"rows {text}: text between the header and the first row: left out")
    if comments:
        found.notes.append(f"{comments} lines of comments between the rows: left out")
    for row, count in zeros:
        note = f"row {row}: {count} zero bytes, as a power cut leaves them: cut, with their line"
        found.notes.append(note)
    return np.array(rows, int)


FORMATS = ("%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S")
"""Formats of dates that are not ISO 8601, the day before the month."""


@dataclass
class Table:
    """Columns of one file, unconverted."""

    file: str
    columns: dict[str, ndarray]
    labels: dict[str, str] = field(default_factory=dict)
    """Column -> its name in messages, where the file has no column of that name."""
    notes: list[str] = field(default_factory=list)
    first_row: int = 0
    """Row of the file in the first row here."""
    rows: ndarray | None = None
    """[T] row of the file of each row here, where they do not follow one another."""
    starts: ndarray = field(default_factory=lambda: np.empty(0, int))
    """Rows here at which another file begins, or the one before them was lost."""
    headerless: bool = False
    """Whether the file has no line of names, so that the columns are named by their position."""

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    @property
    def file_rows(self) -> ndarray:
        """[T] row of the file of each row here."""
        rows = np.arange(len(self)) if self.rows is None else self.rows
        return rows + self.first_row

    def take(self, kept: ndarray) -> "Table":
        """The rows of an increasing index [n]."""
        rows = None if self.rows is None else self.rows[kept]
        if self.rows is None and len(kept) and int(kept[-1]) + 1 != len(kept):
            rows = kept
        starts = np.searchsorted(kept, self.starts)
        columns = {name: values[kept] for name, values in self.columns.items()}
        starts = starts[starts < len(kept)]
        notes = list(self.notes)
        return replace(self, columns=columns, rows=rows, starts=starts, notes=notes)

    def label(self, column: str) -> str:
        """Name of a column in messages."""
        return self.labels.get(column, column)

    def numbers(self, column: str) -> ndarray:
        """A column as float64; empty cells are NaN, dates are seconds since 1970.

        Raises:
            RecordingError: A cell is not a number; the message names the first one.
        """
        values = self.columns[column]
        if values.dtype.kind in "mM":  # times of day, dates
            nanoseconds = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64)
            return np.where(np.isnat(values), np.nan, nanoseconds * 1e-9)
        if values.dtype != object and np.issubdtype(values.dtype, np.number):
            return values.astype(np.float64)
        series = pd.Series(values)
        numbers = np.asarray(pd.to_numeric(series, errors="coerce"), np.float64)
        words = series.astype(str).str.strip().str.lower()
        empty = (series.isna() | words.isin(("nan", ""))).to_numpy()
        bad = np.isnan(numbers) & ~empty
        if bad.any():
            dates = _seconds(series.mask(empty))
            if not np.isnan(dates[~empty]).any():
                return dates
            row = int(np.argmax(bad if np.isnan(dates[~empty]).all() else np.isnan(dates) & ~empty))
            message = (
                f"{str(values[row])!r} is not a number; write plain numbers, decimals with a point"
            )
            raise RecordingError(self.file, message, int(self.file_rows[row]), self.label(column))
        return numbers


def _seconds(series: pd.Series) -> ndarray:
    """Dates or times of day in text as seconds [T]; NaN where they are none."""
    text = series.astype("string").str.strip().str.replace(",", ".")
    text = text.where(~text.str.match(r"\d{4}/"), text.str.replace("/", "-"))
    for form in ("ISO8601", *FORMATS):
        dates = pd.to_datetime(text, format=form, utc=True, errors="coerce")
        if dates.notna().any():
            since = (dates - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
            return np.asarray(since, np.float64)
    times = pd.to_timedelta(text.where(text.str.match(r"[+-]?\d+:\d\d:\d\d")), errors="coerce")
    return np.asarray(times.dt.total_seconds(), np.float64)
