"""Which notes of a recording are printed, by a check of recordings and by what uses them."""

from collections.abc import Iterable

QUIET = (
    "derived from the pose",
    "positions count from",
    ": counted from",
    ": dropped",
    "are read as",
)
"""Parts of the notes that say how a sound recording was read; all others say what to look at."""
DOUBTFUL = (" if ", " assumed", "the clock was set", "held for up to", "the commands stop", "s old")
"""Parts of the notes that say that the recording may not be what it seems."""


def telling(notes: Iterable[str]) -> list[str]:
    """The notes that say what was cut, held, assumed or looks wrong: for a check of recordings."""
    return [note for note in notes if not any(part in note for part in QUIET)]


def doubtful(notes: Iterable[str]) -> list[str]:
    """The notes that say what may be wrong with the whole recording: for all that use it."""
    return [note for note in telling(notes) if any(part in note for part in DOUBTFUL)]
