"""Which notes of a recording are printed without being asked for."""

from collections.abc import Iterable

QUIET = (
    "derived from the pose",
    "positions count from",
    ": counted from",
    ": dropped",
    "are read as",
)
"""Parts of the notes that say how a sound recording was read; all others say what to look at."""


def telling(notes: Iterable[str]) -> list[str]:
    """The notes that say what was cut, held, assumed or looks wrong."""
    return [note for note in notes if not any(part in note for part in QUIET)]
