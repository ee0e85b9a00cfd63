"""Rollouts of several simulators over the same held-out segments, as one file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.files import replacing

EVERY = 4  # rows of the rollout to one that is kept: 25 a second
MEASURED = "measured"


@dataclass(frozen=True)
class Rollouts:
    """Poses of N segments, K instants each."""

    recording: Sequence[str]
    """[N] that each segment is of."""
    time: NDArray[Any]
    """[K] since the start of the segment [s]."""
    pose: Mapping[str, NDArray[Any]]
    """`measured` and each simulator -> [N, K, 3] x, y [m], yaw [rad], world frame."""


def save_rollouts(
    file: Path,
    recording: Sequence[str],
    dt: float,
    measured: TensorDictBase,
    made: Mapping[str, TensorDictBase],
) -> None:
    """Writes every fourth row of rollouts [N, H + 1].

    Args:
        file: An `.npz`.
        recording: [N] names.
        dt: Control period [s].
        measured: [N, H + 1] with `pose`.
        made: Simulator -> [N, H + 1] likewise.
    """
    rows = {MEASURED: measured, **made}
    pose = np.stack([np.asarray(r.get(keys.POSE)[:, ::EVERY]) for r in rows.values()])
    time = dt * EVERY * np.arange(pose.shape[2])
    with replacing(file) as partial, partial.open("wb") as stream:
        np.savez_compressed(
            stream, names=list(rows), recording=list(recording), time=time, pose=pose
        )


def load_rollouts(file: Path) -> Rollouts:
    """What `save_rollouts` wrote."""
    with np.load(file) as content:
        names = content["names"].tolist()
        pose = dict(zip(names, content["pose"], strict=True))
        return Rollouts(content["recording"].tolist(), content["time"], pose)


def median_error(rollouts: Rollouts, name: str) -> float:
    """Median distance [m] from the measured position at the end; inf where most diverge."""
    apart = (rollouts.pose[name] - rollouts.pose[MEASURED])[:, -1, :2]
    return float(np.median(np.nan_to_num(np.hypot(*apart.T), nan=np.inf)))
