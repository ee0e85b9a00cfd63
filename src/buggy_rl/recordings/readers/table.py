"""The result of a reader: named columns of equal length."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError


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

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def label(self, column: str) -> str:
        """Name of a column in messages."""
        return self.labels.get(column, column)

    def numbers(self, column: str) -> ndarray:
        """A column as float64; empty cells are NaN, dates are seconds since 1970.

        Raises:
            RecordingError: A cell is not a number; the message names the first one.
        """
        values = self.columns[column]
        if np.issubdtype(values.dtype, np.datetime64):
            nanoseconds = values.astype("datetime64[ns]").astype(np.int64)
            return np.where(np.isnat(values), np.nan, nanoseconds * 1e-9)
        if values.dtype != object and np.issubdtype(values.dtype, np.number):
            return values.astype(np.float64)
        series = pd.Series(values)
        numbers = np.asarray(pd.to_numeric(series, errors="coerce"), np.float64)
        bad = np.isnan(numbers) & ~series.isna().to_numpy()
        bad &= series.astype(str).str.strip().str.lower().to_numpy() != "nan"
        if bad.any():
            row = int(np.argmax(bad))
            message = (
                f"{str(values[row])!r} is not a number; write plain numbers, decimals with a point"
            )
            raise RecordingError(self.file, message, self.first_row + row, self.label(column))
        return numbers
