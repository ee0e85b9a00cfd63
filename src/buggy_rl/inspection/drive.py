"""Facts of one drive: clocks, motion, commands, delays."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.clock import RowStamps, find_clock, why_no_clock
from buggy_rl.inspection.columns import (
    Guess,
    find_gravity,
    find_rates,
    find_steering,
    find_throttle,
    why_no_steering,
    why_no_throttle,
)
from buggy_rl.inspection.motion import Pose, best_pose, find_poses, why_no_pose
from buggy_rl.inspection.signals import (
    DriveSignals,
    RawDrive,
    filled,
    make_signals,
    number_columns,
    numeric_columns,
    qualified,
    read_drive,
)
from buggy_rl.recordings.recording import RecordingError


@dataclass(frozen=True)
class DriveFacts:
    """What was found in one drive; None where nothing was."""

    name: str
    raw: RawDrive | None = None
    clocks: dict[str, RowStamps] = field(default_factory=dict)
    """Time stamps by table."""
    pose: Pose | None = None
    others: list[Pose] = field(default_factory=list)
    """Further plausible poses."""
    signals: DriveSignals | None = None
    steering: Guess | None = None
    throttle: Guess | None = None
    rates: dict[str, list[Guess]] = field(default_factory=dict)
    """Measured vx and yaw_rate."""
    reasons: dict[str, str] = field(default_factory=dict)
    """Why there is no pose, steering or throttle, where there is none."""
    notes: list[str] = field(default_factory=list)


def inspect_drive(name: str, files: list[Path]) -> DriveFacts:
    """Reads a drive and finds out what its columns are."""
    try:
        return facts_of(read_drive(name, files))
    except RecordingError as error:
        return DriveFacts(name, notes=[str(error)])


def facts_of(raw: RawDrive) -> DriveFacts:
    """What the columns of a drive are."""
    name = raw.name
    columns = {key: numeric_columns(table) for key, table in raw.tables.items()}
    clocks = {key: c for key in columns if (c := find_clock(columns[key])) is not None}
    notes = _notes(raw, columns, clocks)
    for key, clock in clocks.items():
        columns[key] = {**columns[key], **filled(raw.tables[key], clock.t)}
    poses = [
        pose
        for key, clock in clocks.items()
        for pose in find_poses(key, columns[key], clock, _numbered(raw, key))
    ]
    if not poses:
        why = {key: why_no_pose(columns[key], clock) for key, clock in clocks.items()}
        telling = [f"{raw.files[key]}: {text}" for key, text in why.items()]
        reason = "; ".join(telling) or "no table has a time stamp"
        notes.append(f"no two columns x, y move along a heading: {reason}")
        return DriveFacts(name, raw, clocks, reasons={"pose": reason}, notes=notes)
    pose = best_pose(poses)
    signals = make_signals(pose, columns, clocks)
    steering = find_steering(signals)
    throttle = find_throttle(signals, steering)
    commands = {guess.column for guess in (steering, throttle) if guess is not None}
    reasons = {} if steering else {"steering": why_no_steering(signals)}
    reasons |= {} if throttle else {"throttle": why_no_throttle(signals, steering)}
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
        reasons,
        notes + find_gravity(gravity),
    )


def _numbered(raw: RawDrive, key: str) -> dict[str, ndarray]:
    """Columns of numbers of a table without a line of names, those too that do not change."""
    table = raw.tables[key]
    if not all(name.isdigit() for name in table.columns):
        return {}
    return {name: v for name, v in number_columns(table).items() if np.isfinite(v).all()}


def _notes(
    raw: RawDrive, columns: dict[str, dict[str, ndarray]], clocks: dict[str, RowStamps]
) -> list[str]:
    """What tables lack: a line of names, stamps, or stamps of one clock."""
    notes = []
    for key, file in raw.files.items():
        table = raw.tables[key]
        if table.columns and all(name.isdigit() for name in table.columns):
            last = len(table.columns) - 1
            notes.append(f"{file}: no header line: columns are numbered 0 to {last}")
        if key not in clocks:
            notes.append(f"{file}: {why_no_clock(columns[key])}")
            continue
        notes += [f"{file}: row {jump.row}: {jump}" for jump in clocks[key].jumps]
        blank = list(filled(table, clocks[key].t))
        if blank:
            text = "rows of several sources: filled in between, here only"
            notes.append(f"{file}: {', '.join(blank)}: blank in part, {text}")
    return notes
