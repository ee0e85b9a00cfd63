"""Whether drives are fit to be compared, and which conditions were hardly driven."""

import itertools
from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity, wrap_angle
from buggy_rl.diagnosis.answer.named_effect import latencies_refused
from buggy_rl.diagnosis.preflight.simulator import FASTEST
from buggy_rl.estimation.evidence import BLOCK, blocks
from buggy_rl.estimation.segments import WARM_UP, Segments, segment_rows
from buggy_rl.recordings import Recording
from buggy_rl.recordings.windows import window_starts

STANDING = (0.05, 0.1)  # [m] and [rad] within which a car has not moved
CONSTANT = 1e-3  # command
LOST = 0.02  # share of dropped frames that is worth a word
LATE = 0.015  # [s] by which clocks may differ without a word
MOST_BAD = 0.5  # share of segments that may be no numbers


def check_residuals(
    residuals: Tensor, segments: Segments, instants: Tensor, drives: Sequence[str], name: str
) -> list[str]:
    """Whether rollouts of a simulator are numbers that a car could show.

    Args:
        residuals: [N, K, 6] readings minus measurements.
        segments: N segments.
        instants: [K] rows after their start.
        drives: Their names.
        name: What the user calls the simulator.

    Raises:
        ValueError: More than half of the segments are none.
    """
    wrong = ~(residuals.abs() < FASTEST).all(-1)  # (N, K); NaN is not below anything either
    segment = wrong.any(1)
    if not bool(segment.any()):
        return []
    first = int(segment.int().argmax())
    row = int(wrong[first].int().argmax())
    time = float(segments.elapsed[first]) + WARM_UP + int(instants[row]) * segments.dt
    what = "runs away" if bool(residuals[first, row].isfinite().all()) else "returns NaN"
    message = (
        f"simulator {name} {what} in {int(segment.sum())} of {len(residuals)} segments, first in "
        f"drive {drives[int(segments.recording[first])]} at {time:.2f} s"
    )
    if float(segment.double().mean()) > MOST_BAD:
        raise ValueError(
            f"{message}; play the commands of that second into it from the pose and velocity "
            "measured there, and mend it"
        )
    return [f"{message}; those count as very wrong"]


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


def check_blocks(segments: Segments) -> list[str]:
    """Whether segments can be held out by turns at all."""
    count = len(blocks(segments).unique())
    if count > 1:
        return []
    return [
        f"all that was driven lies within one block of {BLOCK:g} s: nothing can be held out, so "
        "nothing can be named; drive for a minute"
    ]


def check_clock(offset: float) -> list[str]:
    """Whether the commands' clock as fitted [s] is that of the motion."""
    if abs(offset) <= LATE:
        return []
    side = "later" if offset > 0 else "earlier"
    return [
        f"commands act {1000 * abs(offset):.0f} ms {side} than they are stamped, throttle and "
        "steering alike: the clocks of commands and motion differ, or both commands are late. "
        "Compare the clocks; where the stamps are off, add "
        f"{offset:+.3f} s to command_offset of the column map and diagnose again"
    ]


def check_latency(effects: Collection[str], offset: float = 0.0) -> list[str]:
    """Says what else a late sensor could be, with the commands' clock as fitted [s]."""
    if "sensor_latency" not in effects:
        return []
    if latencies_refused(offset):
        return [
            "a late sensor was fitted beside a clock that is off by more than stamps are: only the "
            "difference of both is known, so none is named; compare the clocks of commands and "
            "motion, correct command_offset of the column map, and diagnose again"
        ]
    return [
        "a sensor that is late and commands that are stamped too early by as much are the same to "
        "these drives: compare the clocks of both before anything is built on it"
    ]


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


SHOWN = 0.03  # [-] share of the time from which a condition counts as driven
HEADINGS = 8  # sectors of the heading
FAST, SLOW, ROLLING, CRAWLING = 2.0, 1.0, 0.5, 0.1  # [m/s] of the buggy; chosen
BUGGY = Similarity()
QUICK = 5.0  # [1/s] change of the steering command that counts as quick; chosen


def weak(segments: Segments, similarity: Similarity = BUGGY) -> list[str]:
    """A line for each condition that was hardly or never driven, with the effects that it hides.

    Args:
        segments: What was driven.
        similarity: Of the car to the buggy, for which the speeds were chosen.
    """
    fast, slow, rolling, crawling = (similarity.speed * v for v in (FAST, SLOW, ROLLING, CRAWLING))
    rows = slice(segments.start, None)
    vx, yaw_rate = segments.smooth_velocity[:, rows, 0], segments.smooth_velocity[:, rows, 2]
    throttle, steering = segments.action[:, rows].unbind(-1)
    drive, lateral = (throttle + 1) / 2, (vx * yaw_rate).abs()
    yaw = wrap_angle(segments.smooth_pose[:, rows, 2])
    heading = ((yaw + torch.pi) / (2 * torch.pi) * HEADINGS).long().clamp(0, HEADINGS - 1)
    seen = torch.bincount(heading.flatten(), minlength=HEADINGS) / heading.numel()
    checks = (
        ("more than 0.6 of full drive", drive > 0.6, "motor_power_limit, top_speed"),
        (f"above {fast:g} m/s", vx > fast, "aerodynamic_drag, top_speed"),
        (
            f"below {slow:g} m/s",
            (vx < slow) & (vx > crawling),
            "rolling_resistance, throttle_deadband",
        ),
        (
            "coasting without drive",
            (drive < 0.05) & (vx > rolling),
            "rolling_resistance, viscous_drag, aerodynamic_drag apart from the throttle's effects",
        ),
        ("hard left turns", steering > 0.6, "steering_asymmetry"),
        ("hard right turns", steering < -0.6, "steering_asymmetry"),
        ("bends near the limit of grip (5 m/s^2)", lateral > 5.0, "tire_grip, grip_balance"),
        (
            "quick steering",
            segments.action[:, rows, 1].diff(dim=1).abs() > QUICK * segments.dt,
            "steering_dead_time from steering_lag, steering_rate_limit, steering_backlash",
        ),
        ("going straight", (steering.abs() < 0.1) & (vx > rolling), "steering_offset"),
    )
    found = [
        f"{what} hardly driven: hides {hides}"
        for what, mask, hides in checks
        if float(mask.double().mean()) < SHOWN
    ]
    if int((seen > 0.02).sum()) < HEADINGS:
        found.append("not all directions driven: hides floor_slope, wind")
    if float(torch.maximum(segments.elapsed, segments.session).max()) < 30.0:
        found.append("less than 30 s of one recording: hides battery_sag, thermal_foldback")
    return found
