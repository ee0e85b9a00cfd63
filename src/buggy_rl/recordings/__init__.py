"""Recordings of drives: reading, checking, resampling, writing.

Names are looked up on first use, so that this package can be imported without torch or pandas.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from buggy_rl.recordings.columns import ColumnMap, load_columns
    from buggy_rl.recordings.errors import RecordingError, Refusal
    from buggy_rl.recordings.limits import Limits
    from buggy_rl.recordings.loading import find_recordings, load_recording, load_recordings
    from buggy_rl.recordings.recording import Recording
    from buggy_rl.recordings.saving import save_recording

__all__ = [
    "ColumnMap",
    "Limits",
    "Recording",
    "RecordingError",
    "Refusal",
    "find_recordings",
    "load_columns",
    "load_recording",
    "load_recordings",
    "save_recording",
]

_HOME = {
    **{"ColumnMap": "columns", "load_columns": "columns", "Limits": "limits"},
    **{"RecordingError": "errors", "Refusal": "errors", "Recording": "recording"},
    **{"find_recordings": "loading", "load_recording": "loading", "load_recordings": "loading"},
    "save_recording": "saving",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
