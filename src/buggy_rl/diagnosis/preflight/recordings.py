"""Whether drives are fit to be compared."""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.estimation.evidence import BLOCK
from buggy_rl.estimation.segments import segment_rows
from buggy_rl.recordings import Recording
from buggy_rl.recordings.windows import window_starts

STANDING = (0.05, 0.1)  # [m] and [rad] within which a car has not moved
CONSTANT = 1e-3  # command
LOST = 0.02  # share of dropped frames that is worth a word


def check_drives(
    recordings: Sequence[Recording], seconds: float, dt: float = CONTROL_PERIOD
) -> list[str]:
    """Whether drives show enough to compare a simulator with.

    Args:
        recordings: Drives.
        seconds: Length of a rollout; as much measured motion as settles hidden states goes before.
        dt: Control period of the simulator [s].

    Returns:
        Notes on what they cannot show.

    Raises:
        ValueError: There are none, their control periods differ from the simulator's, they hold
            what is no number, none covers a segment, or none moves.
    """
    if not recordings:
        raise ValueError("no drive to compare with: give recordings=[file or folder, ...]")
    for recording in recordings:
        _check_numbers(recording, dt)
    length = segment_rows(seconds, dt)
    notes = _covered(recordings, length) + _moving(recordings) + _commanded(recordings)
    notes += [note for r in recordings for note in _dropped(r, length)]
    if len(recordings) == 1:
        notes.append(
            f"one drive only: blocks of {BLOCK:g} s of it are held out in turn, no whole drive; "
            "a second drive would prove more"
        )
    return notes


def _check_numbers(recording: Recording, dt: float) -> None:
    if abs(recording.dt - dt) > 1e-9:
        raise ValueError(
            f"drive {recording.name} has control period {recording.dt:g} s, the simulator "
            f"{dt:g} s: load it at rate={1 / dt:g}"
        )
    for key in (keys.POSE, keys.VELOCITY, keys.ACTION):
        fine: Tensor = torch.isfinite(recording.data[key]).all(-1)  # (T,)
        if not bool(fine.all()):
            raise ValueError(
                f"drive {recording.name}, row {int(fine.int().argmin())}: {key} is no number; "
                "cut such rows out"
            )


def _covered(recordings: Sequence[Recording], length: int) -> list[str]:
    without = [r for r in recordings if not len(window_starts(r.data[keys.SEGMENT], length, 1))]
    need = f"{length * recordings[0].dt:.2f} s without a gap"
    if len(without) == len(recordings):
        longest = ", ".join(f"{r.name} has {_longest(r):.2f} s" for r in without)
        raise ValueError(f"no drive covers {need} ({longest}): drive longer, or set seconds= lower")
    return [
        f"drive {r.name} is left out: its longest part is {_longest(r):.2f} s, not {need}"
        for r in without
    ]


def _longest(recording: Recording) -> float:
    """Longest time without a gap [s]."""
    return int(recording.data[keys.SEGMENT].bincount().max()) * recording.dt


def _moving(recordings: Sequence[Recording]) -> list[str]:
    still = []
    for recording in recordings:
        pose = recording.data[keys.POSE]
        extent = pose.amax(0) - pose.amin(0)
        if float(extent[:2].max()) < STANDING[0] and float(extent[2]) < STANDING[1]:
            still.append(recording.name)
    if len(still) == len(recordings):
        raise ValueError(f"the car does not move in {', '.join(still)}: drive it about")
    return [f"the car does not move in drive {name}" for name in still]


def _commanded(recordings: Sequence[Recording]) -> list[str]:
    action = torch.cat([r.data[keys.ACTION] for r in recordings])
    extent = action.amax(0) - action.amin(0)
    return [
        f"{command} is {float(action[0, i]):.2f} all the time: nothing that depends on it, or "
        "follows it late, can be told"
        for i, command in enumerate(("throttle", "steering"))
        if float(extent[i]) < CONSTANT
    ]


def _dropped(recording: Recording, length: int) -> list[str]:
    time = recording.data[keys.TIME][:, 0]
    all_ = round(float(time[-1] - time[0]) / recording.dt) + 1
    lost = 1 - len(recording) / all_
    if lost <= LOST:
        return []
    runs = recording.data[keys.SEGMENT].bincount().tolist()
    usable = sum(run for run in runs if run >= length)
    gaps = sum(1 for a, b in itertools.pairwise(runs) if a and b)
    return [
        f"drive {recording.name}: {lost:.0%} of the frames are missing, in {gaps} gaps; "
        f"{usable * recording.dt:.1f} of {all_ * recording.dt:.1f} s can be compared"
    ]
