"""Figures of recordings, simulators and policies, and films of them."""

import importlib
from typing import Any

HOMES = {  # imported when asked for: `--help` reads what is beside this file without matplotlib
    "histogram_figure": "histograms",
    "learning_figure": "learning",
    "paths_figure": "paths",
    "policies_figure": "policies",
    "rollout_figure": "rollouts",
    "save_figure": "style",
    "table_figure": "tables",
}


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        raise AttributeError(f"{__name__} has no {name!r}; available: {', '.join(HOMES)}")
    return getattr(importlib.import_module(f"{__name__}.{HOMES[name]}"), name)
