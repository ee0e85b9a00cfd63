"""Facts of one drive: clocks, motion, commands, delays."""

from dataclasses import dataclass, field
from pathlib import Path

from buggy_rl.inspection.clock import Clock, find_clock
from buggy_rl.inspection.columns import (
    Guess,
    find_gravity,
    find_rates,
    find_steering,
    find_throttle,
)
from buggy_rl.inspection.motion import Pose, best_pose, find_poses
from buggy_rl.inspection.raw_drive import RawDrive, numeric_columns, qualified, read_drive
from buggy_rl.inspection.signals import Signals, make_signals
from buggy_rl.recordings.errors import RecordingError


@dataclass(frozen=True)
class DriveFacts:
    """What was found in one drive; None where nothing was."""

    name: str
    raw: RawDrive | None = None
    clocks: dict[str, Clock] = field(default_factory=dict)
    """By table."""
    pose: Pose | None = None
    others: list[Pose] = field(default_factory=list)
    """Further plausible poses."""
    signals: Signals | None = None
    steering: Guess | None = None
    throttle: Guess | None = None
    rates: dict[str, list[Guess]] = field(default_factory=dict)
    """Measured vx and yaw_rate."""
    notes: list[str] = field(default_factory=list)


def inspect_drive(name: str, files: list[Path]) -> DriveFacts:
    """Reads a drive and finds out what its columns are."""
    try:
        raw = read_drive(name, files)
    except RecordingError as error:
        return DriveFacts(name, notes=[str(error)])
    columns = {key: numeric_columns(table) for key, table in raw.tables.items()}
    clocks = {key: c for key in columns if (c := find_clock(columns[key])) is not None}
    unstamped = [raw.files[key] for key in columns if key not in clocks]
    notes = [f"{file}: no column is a time stamp: none increases strictly" for file in unstamped]
    poses = [p for key, clock in clocks.items() for p in find_poses(key, columns[key], clock)]
    if not poses:
        notes.append("no two columns x, y move along a heading: no position, or the car stands")
        return DriveFacts(name, raw, clocks, notes=notes)
    pose = best_pose(poses)
    signals = make_signals(pose, columns, clocks)
    steering = find_steering(signals)
    throttle = find_throttle(signals, steering)
    commands = {guess.column for guess in (steering, throttle) if guess is not None}
    gravity = {qualified(key, n): v for key, values in columns.items() for n, v in values.items()}
    return DriveFacts(
        name,
        raw,
        clocks,
        pose,
        [
            other
            for other in poses
            if other.names["x"] != pose.names["x"] or other.table != pose.table
        ],
        signals,
        steering,
        throttle,
        find_rates(signals, commands),
        notes + find_gravity(gravity),
    )
