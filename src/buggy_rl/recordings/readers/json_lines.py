"""JSON Lines: one object a line, as loggers of messages write."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.table import Table
from buggy_rl.recordings.readers.text import decoded


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
