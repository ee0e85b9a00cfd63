"""Files that are there as a whole or not at all."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A file beside `file` to write to; it takes the place of `file` when the block ends well.

    A process that is killed in the block leaves `file` as it was.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(file.name + ".partial")
    try:
        yield partial
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)


def write_atomically(file: Path, content: str | bytes) -> None:
    """Writes text (UTF-8) or bytes."""
    with replacing(file) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


def write_json(file: Path, content: object) -> None:
    """Writes JSON, one space of indent a level."""
    write_atomically(file, json.dumps(content, indent=1) + "\n")


def save_torch(file: Path, content: Any) -> None:
    """Writes what `torch.load` reads."""
    import torch

    with replacing(file) as partial:
        torch.save(content, partial)
