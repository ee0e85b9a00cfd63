"""Whether the commands of recordings can have moved the car at all, before anything is compared.

A diagnosis reads every difference as physics. Where a table's columns are exchanged, hold another
car's commands, or the car was pushed, that is a list of effects with no meaning.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.command_response import Response, response
from buggy_rl.recordings import Recording
from buggy_rl.recordings.filters import local_parabola

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
SMOOTHED = 0.15  # [s] of the local parabola of the velocities


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
    notes, found = _pushed(recordings), response(recordings)
    return CommandCheck([] if found is None else _unpredicted(found), notes)


def _unpredicted(found: Response) -> list[str]:
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
