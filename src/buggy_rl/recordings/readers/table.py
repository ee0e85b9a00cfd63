"""The result of a reader: named columns of equal length."""

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError

FORMATS = ("%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S")
"""Of dates that are not ISO 8601, the day before the month."""


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
