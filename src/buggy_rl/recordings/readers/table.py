"""What every reader returns: named columns of equal length."""

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
    """How a column is called in messages, where the file has no column of that name."""
    notes: list[str] = field(default_factory=list)
    first_row: int = 0
    """Row of the file that the first row here is."""

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def label(self, column: str) -> str:
        """What a message calls the column."""
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
            reason = f"{str(values[row])!r} is not a number"
            raise RecordingError(
                *(self.file, self.first_row + row, self.label(column), reason),
                "write plain numbers, with a point for the decimals",
            )
        return numbers
