"""Open-loop errors: rollouts of a simulator under the commands of held-out recordings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.files import replacing
from buggy_rl.core.vehicle import wrap_angle
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS, Segments


def open_loop(make: Callable[[int], EnvBase], segments: Segments) -> TensorDict:
    """Rolls a simulator out along N segments; what is returned is what its sensor shows.

    Over the first rows the segments' smoothed motion is imposed, so that delays, lags, wheel speeds
    and memories settle; from there the simulator runs alone.

    Returns:
        TensorDict [N, H + 1] with `pose` and `velocity`; row 0 is the imposed start.
    """
    read = Simulation(make, every=1).readings(segments)[0]  # (N, H, 6)
    start = torch.cat([segments.smooth_pose, segments.smooth_velocity], -1)
    return _motion(torch.cat([start[:, segments.start : segments.start + 1], read], 1))


def measured_motion(segments: Segments) -> TensorDict:
    """What a rollout is compared with, TensorDict [N, H + 1] with `pose` and `velocity`."""
    return _motion(segments.measured[:, segments.start :])


def _motion(motion: Tensor) -> TensorDict:
    pose, velocity = motion.split(3, -1)
    return TensorDict({keys.POSE: pose, keys.VELOCITY: velocity}, motion.shape[:2])


@dataclass(frozen=True)
class OpenLoopError:
    """Errors of a simulator over windows, one number a window; [N] each, by horizon in seconds."""

    position_mse: dict[float, Tensor]
    """Mean over time of the squared distance [m^2], the original study's equation 5.2."""
    position: dict[float, Tensor]
    """Distance at the end [m]."""
    yaw: dict[float, Tensor]
    """Absolute heading error at the end [rad]."""
    velocity_mse: dict[float, Tensor]
    """Mean over time of the squared error of vx, vy [m^2/s^2], yaw_rate [rad^2/s^2]; [N, 3]."""
    furthest: Tensor
    """Largest speed [m/s] met in a rollout; not finite where one ran away."""


def open_loop_error(made: TensorDictBase, measured: TensorDictBase, dt: float) -> OpenLoopError:
    """Compares rollouts with what was measured.

    Args:
        made: [N, H + 1] from `open_loop`.
        measured: [N, H + 1] the same rows of the drives.
        dt: Control period [s].
    """
    error = made[keys.POSE] - measured[keys.POSE]  # (N, H + 1, 3)
    squared = error[..., :2].square().sum(-1)
    heading = wrap_angle(error[..., 2]).abs()
    velocity = (made[keys.VELOCITY] - measured[keys.VELOCITY]).square()
    steps = {h: round(h / dt) for h in HORIZONS if round(h / dt) < error.shape[1]}
    return OpenLoopError(
        position_mse={h: squared[:, 1 : n + 1].mean(1) for h, n in steps.items()},
        position={h: squared[:, n].sqrt() for h, n in steps.items()},
        yaw={h: heading[:, n] for h, n in steps.items()},
        velocity_mse={h: velocity[:, 1 : n + 1].mean(1) for h, n in steps.items()},
        furthest=torch.linalg.vector_norm(made[keys.VELOCITY][..., :2], dim=-1).amax(1),
    )


def bootstrap_interval(
    values: Tensor, groups: Tensor, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """95 % interval of a mean by resampling groups of windows: neighbours are not independent.

    Args:
        values: [N] one number a window.
        groups: [N] int, windows with the same number are drawn together.
        draws: Resamples.
        seed: Of the resampling.
    """
    _, group = groups.unique(return_inverse=True)
    count = int(group.max()) + 1
    total = torch.zeros(count, dtype=torch.float64).index_add_(0, group, values.double())
    size = torch.zeros(count, dtype=torch.float64).index_add_(
        0, group, torch.ones_like(values, dtype=torch.float64)
    )
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randint(count, (draws, count), generator=generator)
    means = total[chosen].sum(1) / size[chosen].sum(1)
    edge = (1 - 0.95) / 2
    low, high = torch.quantile(means, torch.tensor([edge, 1 - edge], dtype=torch.float64)).tolist()
    return low, high


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
