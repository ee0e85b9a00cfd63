"""Reference paths: waypoints at equal spacing, as tensors that many cars can share."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # at run time `--help` reads what is beside this file without paying for torch
    from buggy_rl.task.paths.making import PathConfig, make_paths
    from buggy_rl.task.paths.path_set import PathSet, joined_paths

__all__ = ["PathConfig", "PathSet", "joined_paths", "make_paths"]
HOMES = {
    "PathConfig": "making",
    "make_paths": "making",
    "PathSet": "path_set",
    "joined_paths": "path_set",
}


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        raise AttributeError(f"{__name__} has no {name!r}; available: {', '.join(__all__)}")
    return getattr(importlib.import_module(f"{__name__}.{HOMES[name]}"), name)
