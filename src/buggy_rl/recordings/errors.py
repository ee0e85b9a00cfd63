"""The error of a recording that cannot be used."""


class RecordingError(ValueError):
    """A recording is refused; one line names file, row, column, value and remedy.

    Rows count from 0 below the header, as in pandas: row r of a CSV file is on line r + 2.

    Args:
        file: The recording.
        message: What is wrong, with the value, and after a semicolon what to do.
        row: Row in the file; None for all.
        column: Column as the file names it; None for all.
    """

    def __init__(
        self, file: str, message: str, row: int | None = None, column: str | None = None
    ) -> None:
        self.file, self.row, self.column = file, row, column
        rows = "all rows" if row is None else f"row {row}"
        columns = "all columns" if column is None else f"column {column}"
        super().__init__(" ".join(f"recording {file}, {rows}, {columns}: {message}".split()))
