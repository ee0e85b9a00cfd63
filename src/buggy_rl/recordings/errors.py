"""Why a drive is refused: one line that names the file, the row, the column and what to do."""

from dataclasses import dataclass


class RecordingError(ValueError):
    """A drive that cannot be trusted.

    Rows count from 0 below the header, as pandas counts them: row r of a CSV stands on line r + 2.
    """

    def __init__(
        self, file: str, row: int | None, column: str | None, reason: str, remedy: str
    ) -> None:
        self.file, self.row, self.column = file, row, column
        self.reason, self.remedy = reason, remedy
        super().__init__(" ".join(self._line().split()))

    def _line(self) -> str:
        row = "all" if self.row is None else self.row
        column = "all" if self.column is None else repr(self.column)
        return f"{self.file}: row {row}, column {column}: {self.reason}; {self.remedy}"


@dataclass(frozen=True)
class Refusal:
    """A drive that was left out, and why."""

    file: str
    error: RecordingError

    def __str__(self) -> str:
        return str(self.error)
