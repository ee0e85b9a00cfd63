"""What the page's player shows: segments on the floor, and their rollouts, as plain lists."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.identification.rollouts import MEASURED, Rollouts

SHOWN = 40  # segments, of which a study has hundreds; chosen for the size of the page
SECONDS = 2.0  # of each
HORIZON = 1.0  # [s] at which a segment's error is told
MILLIMETRES = 3  # decimals of a position; of an angle 3 too
FARTHEST = 50.0  # [m] from the start, beyond which a diverged simulator is cut off


def player(rollouts: Rollouts, simulators: Sequence[str]) -> dict[str, Any]:
    """Segments spread evenly over the held-out recordings.

    Args:
        rollouts: Of the study's table.
        simulators: Those shown, in this order.

    Returns:
        `time` [K] s; `segments`, each with `recording`, `measured` [K][3], `made` (simulator ->
        [K'][3], K' <= K where it diverges) and `error` (simulator -> m after `HORIZON`, None where
        it is not finite).
    """
    kept = rollouts.time <= SECONDS + 1e-9
    count = len(rollouts.recording)
    chosen = np.unique(np.linspace(0, count - 1, min(SHOWN, count)).round().astype(int))
    row = int(np.abs(rollouts.time - HORIZON).argmin())
    segments = []
    for index in chosen.tolist():
        measured = rollouts.pose[MEASURED][index]
        made = {name: rollouts.pose[name][index] for name in simulators}
        segments.append(
            {
                "recording": rollouts.recording[index],
                "measured": _listed(measured[kept]),
                "made": {name: _listed(pose[kept]) for name, pose in made.items()},
                "error": {name: _error(pose[row], measured[row]) for name, pose in made.items()},
            }
        )
    return {"time": np.round(rollouts.time[kept], 3).tolist(), "segments": segments}


def _listed(pose: NDArray[Any]) -> list[list[float]]:
    """Rows up to the first that is not finite or too far away."""
    away = np.hypot(*(pose[:, :2] - pose[0, :2]).T)
    bad = ~np.isfinite(pose).all(1) | (away > FARTHEST)
    end = int(bad.argmax()) if bad.any() else len(pose)
    return np.round(pose[:end].astype(float), MILLIMETRES).tolist()


def _error(made: NDArray[Any], measured: NDArray[Any]) -> float | None:
    """Distance [m]."""
    distance = float(np.hypot(*(made - measured)[:2]))
    return round(distance, 4) if np.isfinite(distance) else None
