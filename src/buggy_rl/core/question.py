"""The question that a result answers: its settings, and the content of all that it reads.

Stages of a diagnosis, models, policies and studies are kept under their question, and go on only
with the same one. It has the content of recordings as they are computed with, of every file that a
setting names, and of what these files name or import in turn. Our own source is not part of it; of
what is kept half done the package's version is, and a number that is raised with its layout.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from buggy_rl import __version__
from buggy_rl.core.reads import files_read

Question = dict[str, Any]
CONTENT = "content of "  # begins the name of a file's or a recording's digest
SHOWN = 4  # differences in a message


def question(
    settings: Any,
    recordings: Iterable[Any] = (),
    ignoring: Sequence[str] = (),
    **more: Any,
) -> Question:
    """What a result depends on, as flat names and plain values.

    Args:
        settings: A config, or nested dictionaries of plain values.
        recordings: `Recording`s that are computed with.
        ignoring: Dotted names of settings that change no result, or whose effect is in the
            recordings.
        more: Further settings.
    """
    given = settings if isinstance(settings, Mapping) else asdict(settings)
    found: Question = {}
    for name, value in _flat({**given, **more}):
        if not any(name == other or name.startswith(f"{other}.") for other in ignoring):
            found |= _setting(name, value)
    return found | contents(recordings)


def contents(recordings: Iterable[Any], role: str = "recording") -> Question:
    """Digests of recordings as they are computed with, whatever file they were read from."""
    found: Question = {}
    for recording in recordings:
        found[_free(found, f"{CONTENT}{role} {recording.name}")] = _digest(recording)
    return found


def schema(number: int) -> str:
    """Version of what is kept half done, by its layout's number and the package's version."""
    return f"{number} of buggy_rl {__version__}"


def key(asked: Question) -> str:
    """16 hexadecimal digits."""
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:16]


def _differences(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two questions, a clause each."""
    names = [*now, *(name for name in was if name not in now)]
    return [_difference(n, was, now) for n in names if was.get(n, _NONE) != now.get(n, _NONE)]


def difference(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What differs between two questions, in one line; empty if nothing does."""
    found = _differences(was, now)
    rest = f"; and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return "; ".join(found[:SHOWN]) + rest


def refuse_another(was: Any, now: Question, what: str, remedy: str) -> None:
    """Compares the question of something kept with the one that is asked now.

    Args:
        was: The kept one; None where it says none.
        now: The one that is asked.
        what: Is kept, such as a file.
        remedy: What to do where they differ.

    Raises:
        ValueError: They differ; the message names how.
    """
    if not isinstance(was, dict):
        raise ValueError(
            f"{what} does not say what it was made from, an earlier version wrote it: {remedy}"
        )
    if said := difference(was, now):
        raise ValueError(f"{what} answers another question: {said}; {remedy}")


_NONE = object()


def _difference(name: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    if not name.startswith(CONTENT):
        return f"{name} was {was.get(name, 'not set')}, now {now.get(name, 'not set')}"
    what = name.removeprefix(CONTENT)
    if name not in now:
        return f"{what} is no longer read"
    return f"{what} has other content now" if name in was else f"{what} was not read before"


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _setting(name: str, value: Any) -> Question:
    """A setting; one that names files by their names alone, and by their content."""
    listed = value if isinstance(value, (list, tuple)) else [value]
    found: Question = {}
    plain = value if isinstance(value, (bool, int, float, str, type(None))) else json.dumps(value)
    for text in (one for one in listed if isinstance(one, str)):
        files = files_read(text)
        if files and text == value:  # a moved folder is no other question
            code = not Path(text).is_file()
            plain = files[0].name + (f":{text.rpartition(':')[2]}" if code else "")
        for file in files:
            label = os.path.relpath(file, files[0].parent)
            found[f"{CONTENT}{label}"] = hashlib.sha256(file.read_bytes()).hexdigest()
    return {name: plain, **found}


def _digest(recording: Any) -> str:
    digest = hashlib.sha256(f"{recording.dt!r} {recording.command!r}".encode())
    for name, value in sorted(recording.data.items()):
        digest.update(f"{name} {tuple(value.shape)}".encode())
        digest.update(value.contiguous().numpy().tobytes())
    return digest.hexdigest()


def _free(taken: Mapping[str, Any], name: str) -> str:
    number, free = 2, name
    while free in taken:
        number, free = number + 1, f"{name} ({number})"
    return free
