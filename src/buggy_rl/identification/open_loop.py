"""How far a simulator can be trusted: the same commands played into it, against held-out drives."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.estimation.segments import HORIZONS, WARM_UP
from buggy_rl.vehicle import wrap_angle


@torch.no_grad()
def open_loop(
    make: Callable[[int], EnvBase],
    windows: TensorDictBase,
    start_velocity: Tensor | None = None,
    warm_up: int = WARM_UP,
    chunk: int = 2048,
) -> TensorDict:
    """Plays the commands of windows into a simulator.

    Over the first `warm_up` rows the measured pose and velocity are imposed at every step, so
    that delays, lags, wheel speeds and memories settle; from there the simulator runs alone.

    Args:
        make: Builds the simulator for a number of cars.
        windows: [N, L] with `pose`, `velocity`, `action`.
        start_velocity: [N, warm_up + 1, 3] velocities to impose instead of the measured ones
            (a model trained on filtered velocities is started from filtered ones).
        warm_up: Rows.
        chunk: Most cars at once, to bound memory.

    Returns:
        TensorDict [N, L - warm_up] with `pose` and `velocity`; row 0 is the imposed start.
    """
    parts = []
    for first in range(0, len(windows), chunk):
        rows = slice(first, first + chunk)
        start = windows[keys.VELOCITY] if start_velocity is None else start_velocity
        parts.append(_open_loop(make, windows[rows], start[rows], warm_up))
    return TensorDict.cat(parts)  # type: ignore[return-value]


def _open_loop(make, windows: TensorDictBase, start: Tensor, warm_up: int) -> TensorDict:
    count, length = windows.batch_size
    engine = make(count)
    pose, action = windows[keys.POSE], windows[keys.ACTION]
    imposed = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: start[:, 0]}, [count])
    state = engine.reset(imposed.to(engine.device))
    trail = []
    for row in range(length):
        if row <= warm_up:
            state[keys.POSE] = pose[:, row].to(engine.device)
            state[keys.VELOCITY] = start[:, row].to(engine.device)
        if row >= warm_up:
            trail.append(state.select(keys.POSE, keys.VELOCITY).cpu())
        if row < length - 1:
            state[keys.ACTION] = action[:, row].to(engine.device)
            state = engine.step(state)["next"]
    return TensorDict.stack(trail, 1)  # type: ignore[return-value]


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
    gap = made[keys.POSE] - measured[keys.POSE]  # (N, H + 1, 3)
    squared = gap[..., :2].square().sum(-1)
    heading = wrap_angle(gap[..., 2]).abs()
    velocity = (made[keys.VELOCITY] - measured[keys.VELOCITY]).square()
    steps = {h: round(h / dt) for h in HORIZONS if round(h / dt) < gap.shape[1]}
    return OpenLoopError(
        position_mse={h: squared[:, 1 : n + 1].mean(1) for h, n in steps.items()},
        position={h: squared[:, n].sqrt() for h, n in steps.items()},
        yaw={h: heading[:, n] for h, n in steps.items()},
        velocity_mse={h: velocity[:, 1 : n + 1].mean(1) for h, n in steps.items()},
        furthest=torch.linalg.vector_norm(made[keys.VELOCITY][..., :2], dim=-1).amax(1),
    )


def bootstrap_interval(
    values: Tensor, groups: Tensor, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Interval of a mean by resampling groups of windows: neighbours are not independent.

    Args:
        values: [N] one number a window.
        groups: [N] int, windows with the same number are drawn together.
        level: Coverage.
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
    edge = (1 - level) / 2
    low, high = torch.quantile(means, torch.tensor([edge, 1 - edge], dtype=torch.float64)).tolist()
    return low, high
