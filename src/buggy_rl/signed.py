"""Files that are read back only on the machine of the user who wrote them.

A pickle runs code when it is read. What is kept half done in an output folder, which may be handed
on, is signed: HMAC-SHA256 of the file's name and content, with a random key in the user's cache
folder (XDG_CACHE_HOME, else ~/.cache). A file without that signature is not read.
"""

import hashlib
import hmac
import io
import os
import secrets
from functools import cache
from pathlib import Path
from typing import Any

from buggy_rl.files import write_atomically

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
