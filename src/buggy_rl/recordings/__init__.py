"""Recordings of drives: reading, checking, resampling, writing.

Names are imported on first use: `--help` of a script finds its config in this package without
importing torch or pandas.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from buggy_rl.recordings.columns import ColumnMap as ColumnMap
    from buggy_rl.recordings.loading import load_recording as load_recording
    from buggy_rl.recordings.loading import load_recordings as load_recordings
    from buggy_rl.recordings.recording import Recording as Recording
    from buggy_rl.recordings.recording import RecordingError as RecordingError
    from buggy_rl.recordings.saving import save_command as save_command
    from buggy_rl.recordings.saving import save_recording as save_recording

_MODULES = {
    **{"ColumnMap": "columns", "RecordingError": "recording", "Recording": "recording"},
    **{"load_recording": "loading", "load_recordings": "loading", "save_recording": "saving"},
    "save_command": "saving",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
