"""Rows of a CSV that a benchmark goes on from where it was interrupted."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def rows_of(file: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Rows that are written; none where there is no file.

    Raises:
        ValueError: It has other columns.
    """
    if not file.exists():
        return []
    with open(file, newline="") as lines:
        reader = csv.DictReader(lines)
        if tuple(reader.fieldnames or ()) != tuple(columns):
            raise ValueError(
                f"{file}: columns {reader.fieldnames}, expected {list(columns)}: use another output"
            )
        return list(reader)


def appended(file: Path, columns: Sequence[str], row: Mapping[str, Any]) -> dict[str, Any]:
    """Appends a row, below a head where the file is new; columns that it lacks stay empty."""
    file.parent.mkdir(parents=True, exist_ok=True)
    whole = {name: row.get(name, "") for name in columns}
    new = not file.exists()
    with open(file, "a", newline="") as lines:
        writer = csv.DictWriter(lines, columns, lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(whole)
    return whole
