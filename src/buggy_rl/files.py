"""Files that are there as a whole or not at all."""

import json
import pickle
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
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


def remove_folder(folder: Path, names: Iterable[str] = ()) -> None:
    """Takes files of these names away, and the folder if nothing else is in it."""
    for name in names:
        (folder / name).unlink(missing_ok=True)
        (folder / f"{name}.partial").unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def clear_folder(folder: Path, own: Collection[str]) -> None:
    """Takes away a folder of files whose names, within it, match patterns.

    Raises:
        ValueError: It holds another file; nothing is taken away then.
    """
    files = [file for file in folder.rglob("*") if not file.is_dir()]
    named = {file: file.relative_to(folder).as_posix().removesuffix(".partial") for file in files}
    others = [f for f, name in named.items() if not any(fnmatch(name, n) for n in own)]
    if others:
        raise ValueError(
            f"{others[0]} was not written by what is to be written there anew: move it elsewhere"
        )
    for file in files:
        file.unlink()
    places = [place for place in folder.rglob("*") if place.is_dir()]
    for place in [*sorted(places, reverse=True), *([folder] if folder.is_dir() else [])]:
        place.rmdir()


def write_json(file: Path, content: object) -> None:
    """Writes JSON, one space of indent a level."""
    write_atomically(file, json.dumps(content, indent=1) + "\n")


def load_torch(file: Path | str) -> Any:
    """Reads what `save_torch` wrote: tensors and plain values, on the CPU; no code is run.

    Raises:
        ValueError: It is something else.
    """
    import torch

    try:
        return torch.load(file, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        why = str(error).partition("\n")[0]
        raise ValueError(
            f"{file} holds more than weights and plain values, or is cut off; it is not read: {why}"
        ) from None


def save_torch(file: Path, content: Any) -> None:
    """Writes what `load_torch` reads."""
    import torch

    with replacing(file) as partial:
        torch.save(content, partial)
