"""Files that are whole or not there, and signed ones that their writer alone reads back."""

import hashlib
import hmac
import io
import json
import os
import pickle
import secrets
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from functools import cache
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


def rounded(value: Any, digits: int) -> Any:
    """Every number to so many significant digits, however deep."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, dict):
        return {key: rounded(v, digits) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(v, digits) for v in value]
    return value


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


MARK = b"buggy_rl signed 1\n"
SIZE = hashlib.sha256().digest_size
KEY = Path("buggy_rl") / "signing_key"  # in the cache folder


def save_signed(file: Path, content: Any) -> None:
    """Writes what `load_signed` reads: anything that `torch.save` takes."""
    import torch

    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_signed(file, buffer.getvalue())


def load_signed(file: Path) -> Any:
    """Reads what `save_signed` wrote.

    Raises:
        ValueError: This user has not written it on this machine.
    """
    import torch

    return torch.load(io.BytesIO(read_signed(file)), weights_only=False)


def write_signed(file: Path, content: bytes) -> None:
    """Writes bytes with their signature before them."""
    write_atomically(file, MARK + _signature(file, content) + content)


def read_signed(file: Path) -> bytes:
    """Reads what `write_signed` wrote.

    Raises:
        ValueError: This user has not written it on this machine.
    """
    whole = file.read_bytes()
    content = whole[len(MARK) + SIZE :]
    if whole[: len(MARK) + SIZE] != MARK + _signature(file, content):
        raise ValueError(f"{file} was not written by this user on this machine: it is not read")
    return content


def is_own(file: Path) -> bool:
    """Whether this user has written a file on this machine, by `write_signed`."""
    try:
        read_signed(file)
    except (ValueError, OSError):
        return False
    return True


def _signature(file: Path, content: bytes) -> bytes:
    return hmac.digest(_key(), file.name.encode() + b"\0" + content, "sha256")


@cache
def _key() -> bytes:
    """The user's key; where none can be kept, one of this process alone."""
    cache_folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    file = cache_folder / KEY
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        return _made(file)
    except OSError:  # no home, or one that cannot be written: nothing is gone on with then
        return secrets.token_bytes(SIZE)


def _made(file: Path) -> bytes:
    """The key in a file, which is made where there is none; never half, whoever else makes it."""
    if not file.exists():
        own = file.with_name(f"{file.name}.{os.getpid()}")
        with open(os.open(own, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as made:
            made.write(secrets.token_bytes(SIZE))
        try:
            os.link(own, file)  # fails where another process was first
        except FileExistsError:
            pass
        finally:
            own.unlink()
    return file.read_bytes()
