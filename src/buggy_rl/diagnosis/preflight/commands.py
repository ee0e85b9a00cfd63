"""Whether the commands of recordings can have moved the car at all, before anything is compared.

A diagnosis reads every difference as physics. Where a table's columns are exchanged, hold another
car's commands, or the car was pushed, that is a list of effects with no meaning.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.recordings import Recording
from buggy_rl.recordings.resampling import local_parabola

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
class YawResponse:
    """Shares of the yaw rate's variance that commands explain where they were not fitted."""

    given: float
    """Share that the steering column explains."""
    exchanged: float
    """Share that the throttle column explains in its place."""
    steers: bool
    """Whether it is steered and rolls: nothing is expected of a constant steering, nor of a car
    that slides or stands."""


def yaw_response(recordings: Sequence[Recording]) -> YawResponse | None:
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
    return YawResponse(given, exchanged, rolls and float(rows.commands[:, 0, 1].std()) > VARIES)


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


# Held-out shares of the yaw rate's variance [-], measured where the car rolls: 0.87 to 0.99 by the
# steering of real drives, 0.76 or more with effects as large as 0.3 s of dead time or a third of
# the gain, 0.6 on a ramp of constant steering (where the throttle has 0.84); 0.01 at most by
# commands of another drive.
UNPREDICTED = 0.1  # below which the steering is not what turned the car
EXCHANGED = (0.3, 0.7)  # as given at most, with the columns exchanged at least
IDLE = 0.02  # [-] throttle command from rest within which nothing drives
LATE = 1.0  # [s] after which a throttle that rests has ceased to act: dead time, lag, sensor
GAIN = (0.3, 0.5)  # [m/s], [-] of the driven speed: gained at rest throttle by none but a push
TOP = 0.9  # quantile of the speed that stands for the driven speed
MOVING = 0.1  # [-] of that from which the car moves
MOSTLY = 0.5  # [-] of the time it moves, from which a recording is of a car that is pushed


@dataclass(frozen=True)
class Push:
    """A stretch of a recording in which the car gains speed with the throttle at rest."""

    begins: float
    """[s] since the recording began."""
    ends: float
    gained: float
    """[m/s]"""


@dataclass(frozen=True)
class CommandCheck:
    """What commands tell of themselves."""

    first: list[str]
    """What must be known before anything else: after it no finding can be believed."""
    notes: list[str]


def check_commands(recordings: Sequence[Recording]) -> CommandCheck:
    """Whether commands predict the motion at all; nothing is said of recordings that are sound.

    Raises:
        ValueError: A recording is of a car that moves with the throttle at rest.
    """
    notes, found = _pushed(recordings), yaw_response(recordings)
    return CommandCheck([] if found is None else _unpredicted(found), notes)


def _unpredicted(found: YawResponse) -> list[str]:
    most, least = EXCHANGED
    if found.given < most and found.exchanged > least:
        return [
            "The commands do not predict the motion, exchanged they do: of the yaw rate's "
            f"variance the steering explains {_percent(found.given)} on what was held out, the "
            f"throttle in its place {_percent(found.exchanged)}. Exchange the columns in the "
            "column map (columns=FILE; of a table in the standard columns: `names: {throttle: "
            "steering, steering: throttle}`) and diagnose again; nothing below can be believed."
        ]
    if found.steers and found.given < UNPREDICTED:
        return [
            "The commands do not predict the motion: of the yaw rate's variance the steering "
            f"explains {_percent(found.given)} on what was held out. They may be another car's or "
            "another drive's, another column's, or stamped by a clock that is off by seconds: "
            "compare steering and yaw rate over time (scripts/show_drives.py), name the right "
            "column in the column map and diagnose again; nothing below can be believed."
        ]
    return []


def _percent(share: float) -> str:
    return f"{max(0.0, share):.0%}"


def _pushed(recordings: Sequence[Recording]) -> list[str]:
    speeds = torch.cat([_speed(r.data[keys.VELOCITY], r.dt) for r in recordings])
    top = float(speeds.sort().values[round(TOP * (len(speeds) - 1))])
    least, notes = max(GAIN[0], GAIN[1] * top), []
    for recording in recordings:
        pushes = list(_pushes(recording, least))
        if not pushes:
            continue
        moving = _speed(recording.data[keys.VELOCITY], recording.dt) > MOVING * top
        share = sum(p.ends - p.begins for p in pushes) / (float(moving.sum()) * recording.dt)
        first = max(pushes, key=lambda p: p.gained)
        what = (
            f"drive {recording.name}: from {first.begins:.1f} to {first.ends:.1f} s the car gains "
            f"{first.gained:.1f} m/s with the throttle at rest: it is pushed, carried, or rolls "
            "downhill"
        )
        if share > MOSTLY:
            raise ValueError(
                f"{what}, and so it is in {min(1.0, share):.0%} of the time it moves: the commands "
                "do not predict the motion. Leave it out, or name the column of the throttle that "
                "drove it in the column map (columns=FILE)"
            )
        notes.append(f"{what}. Cut such rows out and diagnose again")
    return notes


def _pushes(recording: Recording, least: float) -> Iterator[Push]:
    """Stretches of resting throttle in which the speed rises by `least` [m/s] or more."""
    data, dt = recording.data, recording.dt
    late = round(LATE / dt)
    begun = float(data[keys.TIME][0, 0])
    for segment in data[keys.SEGMENT].unique():
        inside = data[keys.SEGMENT] == segment
        time, speed = data[keys.TIME][inside][:, 0], _speed(data[keys.VELOCITY][inside], dt)
        rests = (data[keys.ACTION][inside][:, 0] - recording.command.rest).abs() < IDLE
        for first, last in _runs(rests):
            own = speed[first + late : last]
            if not len(own):
                continue
            rise = own - own.cummin(0).values
            if float(rise.max()) >= least:
                begin, end = (float(time[i]) - begun for i in (first, last - 1))
                yield Push(begin, end, float(rise.max()))


def _runs(flags: Tensor) -> list[tuple[int, int]]:
    """First row of each run of true rows [T], and the row after its last."""
    edges = torch.nn.functional.pad(flags.int(), (1, 1)).diff()
    return list(
        zip(
            (edges == 1).nonzero()[:, 0].tolist(),
            (edges == -1).nonzero()[:, 0].tolist(),
            strict=True,
        )
    )


def _speed(velocity: Tensor, dt: float) -> Tensor:
    """Speed [T], smoothed."""
    smooth = local_parabola(velocity, max(5, 2 * round(SMOOTHED / dt / 2) + 1))
    return torch.hypot(smooth[:, 0], smooth[:, 1])
