"""Whether commands predict the motion at all, without a simulator.

The yaw rate r is regressed on lagged steering s, and predicted on blocks that were left out:

    r(t) ~ sum_k (a_k v + b_k |v| + c_k) s(t - k) + p v + q v |v| + p_0,    k up to `LATEST_LAG`

with the speed v, so that neither a gain, an offset, nor a dead time or lag matters. A table whose
columns are exchanged, or that holds the commands of another car, shows it: its steering explains
nothing of the yaw rate. Of the throttle nothing as sharp can be said: a slope, a deadband or ice
leave a few per cent of the speed to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.recordings import Recording
from buggy_rl.recordings.filters import local_parabola

LATEST_LAG = 0.6  # [s] of a command: dead time and lag of servo and sensor together
EVERY = 0.05  # [s] between two lags, and between two rows that are compared
SMOOTHED = 0.15  # [s] of the local parabola of the velocities
FOLD = 8.0  # [s] blocks of which every other one is held out
RIDGE = 1e-2  # [-] of the variance of a regressor
LEAST_TIME = 20.0  # [s] compared, of which anything is said
TURNS = 0.15  # [rad/s] standard deviation of the yaw rate from which a car turns
VARIES = 0.05  # [-] standard deviation of the steering from which it is varied
ROLLS = 0.2  # [m/s] speed from which a car drives
SLIDES = 0.15  # [-] lateral over whole speed from which it slides; chosen
AROUND = 0.5  # [s] before and after a slide in which its yaw rate is not the steering's either
ROLLING = 0.3  # [-] share of the rows from which those that roll stand for the drive


@dataclass(frozen=True)
class Response:
    """Shares of the yaw rate's variance that commands explain where they were not fitted."""

    given: float
    """By the steering column."""
    exchanged: float
    """By the throttle column in its place."""
    steers: bool
    """Whether it is steered and rolls: nothing is expected of a constant steering, nor of a car
    that slides or stands."""


def response(recordings: Sequence[Recording]) -> Response | None:
    """How well commands predict the yaw rate; None where it hardly turns, or for too short."""
    rows = _gathered(recordings)
    if rows is None:
        return None
    # Where it spins the yaw rate is large, and nothing that the steering says of it is linear.
    rolls = float(rows.rolls.double().mean()) > ROLLING
    rows = rows[rows.rolls] if rolls else rows
    if float(rows.yaw_rate.std()) < TURNS or len((rows.block % 2).unique()) < 2:
        return None
    given, exchanged = (
        _explained(rows.steered_by(channel), rows.yaw_rate, rows.block) for channel in (1, 0)
    )
    return Response(given, exchanged, rolls and float(rows.commands[:, 0, 1].std()) > VARIES)


@dataclass(frozen=True)
class _Rows:
    """Rows of recordings that are compared."""

    commands: Tensor
    """[T, K, 2] at each lag."""
    speed: Tensor
    """[T] with the sign of vx [m/s]."""
    yaw_rate: Tensor
    """[T] [rad/s]"""
    rolls: Tensor
    """[T] bool, whether it drives and does not slide about then."""
    block: Tensor
    """[T] int"""

    def __getitem__(self, index: Tensor) -> "_Rows":
        return _Rows(*(value[index] for value in vars(self).values()))

    def steered_by(self, channel: int) -> Tensor:
        """Regressors [T, 3 K + 2] of the yaw rate, by the command in a column."""
        command, speed = self.commands[..., channel], self.speed.unsqueeze(-1)
        turned = [command * speed, command * speed.abs(), command]
        return torch.cat([*turned, speed, speed * speed.abs()], -1)


def _gathered(recordings: Sequence[Recording]) -> _Rows | None:
    """Rows of all recordings; None where they are too few to hold any out."""
    parts = [part for recording in recordings for part in _parts(recording)]
    if not parts:
        return None
    names = ("commands", "speed", "yaw_rate", "rolls", "block")
    rows = _Rows(*(torch.cat([getattr(part, name) for part in parts]) for name in names))
    sides = (rows.block % 2).unique()
    return rows if len(rows.block) * EVERY > LEAST_TIME and len(sides) == 2 else None


def _parts(recording: Recording) -> Iterator[_Rows]:
    """Rows of each part without a gap that is long enough."""
    data, dt = recording.data, recording.dt
    step = max(1, round(EVERY / dt))
    back = torch.arange(0, round(LATEST_LAG / dt) + 1, step)
    window = max(5, 2 * round(SMOOTHED / dt / 2) + 1)
    for segment in data[keys.SEGMENT].unique():
        inside = data[keys.SEGMENT] == segment
        velocity, action = (data[key][inside].double() for key in (keys.VELOCITY, keys.ACTION))
        rows = torch.arange(len(velocity))[int(back[-1]) :: step]
        if len(velocity) < window or not len(rows):
            continue
        vx, vy, yaw_rate = local_parabola(velocity, window)[rows].unbind(-1)
        time = data[keys.TIME][inside][:, 0].double()[rows]
        speed = torch.hypot(vx, vy)
        yield _Rows(
            action[rows.unsqueeze(-1) - back],
            speed * vx.sign(),
            yaw_rate,
            ~_about((vy.abs() > SLIDES * speed) | (speed < ROLLS)),
            (time / FOLD).long(),
        )


def _about(flags: Tensor) -> Tensor:
    """Rows [T] at most `AROUND` from one with a flag."""
    reach = round(AROUND / EVERY)
    near = torch.nn.functional.max_pool1d(flags.double().view(1, 1, -1), 2 * reach + 1, 1, reach)
    return near[0, 0] > 0


def _explained(regressors: Tensor, target: Tensor, block: Tensor) -> float:
    """1 - squared error over variance [-] of a ridge regression, each half by the other."""
    mean = regressors.mean(0)
    scale = regressors.std(0).clamp_min(1e-9)
    x = torch.cat([(regressors - mean) / scale, torch.ones(len(target), 1, dtype=target.dtype)], -1)
    left = torch.zeros_like(target)
    for side in (0, 1):
        out = block % 2 == side
        rest = x[~out]
        gram = rest.mT @ rest + RIDGE * len(rest) * torch.eye(x.shape[1], dtype=x.dtype)
        weight = torch.linalg.solve(gram, rest.mT @ target[~out])
        left[out] = target[out] - x[out] @ weight
    return 1 - float(left.square().sum() / (target - target.mean()).square().sum())
