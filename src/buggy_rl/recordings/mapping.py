"""From the columns of a file to a drive in SI units, body frame and commands in [-1, 1]."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.checks.cells import check_cells, check_quaternions
from buggy_rl.recordings.checks.commands import clip_commands
from buggy_rl.recordings.columns import CHANNELS, QUANTITY, UNITS, ColumnMap
from buggy_rl.recordings.drive import Drive, turn
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers import Table

NEEDED = ("t", "x", "y", "throttle", "steering")
QUATERNION = ("qw", "qx", "qy", "qz")
CLOCK_ORIGIN = 1e6  # [s] stamps above this count from 1970, not from the start of a drive


def map_columns(table: Table, columns: ColumnMap) -> Drive:
    """Converts a table as its column map says.

    Raises:
        RecordingError: A column is missing or holds no numbers, a quaternion is none, or a
            command is outside its range.
    """
    names = _present(table, columns)
    labels = {channel: table.label(name) for channel, name in names.items()}
    raw = {channel: table.numbers(name) for channel, name in names.items()}
    rows = _first_row(table, columns)
    factor = _factor(table, columns)
    raw = {channel: values[rows:] for channel, values in raw.items()}
    row = np.arange(rows, len(table)) + table.first_row
    missing = check_cells(table.file, raw, labels, row, columns.limits)
    check_quaternions(table.file, raw, labels, row, columns.limits)
    si = {channel: _si(channel, values, columns) for channel, values in raw.items()}
    drive = Drive(
        file=table.file,
        t=si["t"] - (si["t"][0] if columns.time_from_first else 0.0),
        pose=np.stack([si["x"], si["y"], _yaw(si, columns)], -1),
        linear=np.stack([si["vx"], si["vy"]], -1) if "vx" in si and "vy" in si else None,
        yaw_rate=si.get("yaw_rate"),
        action=np.stack([si["throttle"], si["steering"]], -1),
        row=row,
        labels=labels | ({} if "yaw" in si else {"yaw": ", ".join(labels[q] for q in QUATERNION)}),
        notes=list(table.notes),
    )
    _note_reading(drive, rows, table, columns, si)
    for channel, cells in missing.items():
        drive.cut(cells, channel, "no value (NaN), the tracker lost the car")
    clip_commands(drive, columns, None if factor is None else factor[rows:])
    _to_reference_point(drive, columns)
    return drive


def _present(table: Table, columns: ColumnMap) -> dict[str, str]:
    """Channel -> column, of the channels that the file has."""
    ignored = set(columns.ignore)
    names = {channel: columns.names.get(channel, channel) for channel in CHANNELS}
    there = {c: n for c, n in names.items() if n in table.columns and n not in ignored}
    stated = [names[c] for c in columns.names if c not in there and names[c] not in ignored]
    missing = [names[c] for c in NEEDED if c not in there]
    if "yaw" not in there and not all(q in there for q in QUATERNION):
        missing.append(f"{names['yaw']} (or {', '.join(names[q] for q in QUATERNION)})")
    missing += [n for n in stated if n not in missing]
    if missing:
        _refuse_missing(table, missing)
    if "yaw" in there:
        there = {c: n for c, n in there.items() if c not in QUATERNION}
    return there


def _refuse_missing(table: Table, missing: list[str]) -> None:
    raise RecordingError(
        *(table.file, None, ", ".join(missing)),
        f"missing; the file has: {', '.join(table.columns)}",
        "name its columns in a column map",
    )


def _first_row(table: Table, columns: ColumnMap) -> int:
    """How many leading rows are to be dropped."""
    drop = columns.drop_leading
    if drop.column is None:
        return 0
    if drop.column not in table.columns:
        _refuse_missing(table, [drop.column])
    waiting = table.numbers(drop.column) == drop.equals
    if waiting.all():
        raise RecordingError(
            *(table.file, 0, drop.column, f"it is {drop.equals:g} to the last row"),
            "correct drop_leading in the column map, or record again",
        )
    return int(np.argmin(waiting))


def _factor(table: Table, columns: ColumnMap) -> ndarray | None:
    name = columns.throttle.factor
    if name is None:
        return None
    if name not in table.columns:
        _refuse_missing(table, [name])
    factor = table.numbers(name)
    bad = ~np.isfinite(factor)
    if bad.any():
        raise RecordingError(
            *(table.file, int(np.argmax(bad)) + table.first_row, name, "no finite number"),
            "correct it, or leave throttle.factor out of the column map",
        )
    return factor


def _si(channel: str, values: ndarray, columns: ColumnMap) -> ndarray:
    unit = columns.units.get(channel)
    factor = UNITS[QUANTITY[channel]][unit] if unit else 1.0
    return values * (factor * columns.signs.get(channel, 1.0))


def _yaw(si: Mapping[str, ndarray], columns: ColumnMap) -> ndarray:
    """Heading [T] rad: yaw = atan2(2 (w z + x y), 1 - 2 (y^2 + z^2)) of a unit quaternion."""
    if "yaw" in si:
        return si["yaw"]
    w, x, y, z = (si[q] for q in QUATERNION)
    sign = columns.signs.get("yaw", 1.0)
    return sign * np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _note_reading(drive: Drive, dropped: int, table: Table, columns: ColumnMap, si) -> None:
    if dropped:
        drop = columns.drop_leading
        last = f"rows {table.first_row}-{table.first_row + dropped - 1}"
        drive.notes.append(f"{last}, column {drop.column!r}: {drop.equals:g}: dropped")
    if ("vx" in si) != ("vy" in si):
        lone = "vx" if "vx" in si else "vy"
        drive.notes.append(
            f"column {drive.label(lone)!r}: not used, the other of vx, vy is missing"
        )
    if columns.time_from_first and si["t"][0] > CLOCK_ORIGIN:
        drive.notes.append(f"column {drive.label('t')!r}: counted from {si['t'][0]:.3f} s")


def _to_reference_point(drive: Drive, columns: ColumnMap) -> None:
    """Moves pose and velocity from the tracker to the car's reference point."""
    mount = columns.mount
    yaw = drive.pose[:, 2] - mount.yaw
    arm = np.array([mount.x, mount.y])
    if drive.linear is not None:
        if columns.velocity_frame == "world":
            drive.linear = turn(drive.linear, -yaw)
        else:
            drive.linear = turn(drive.linear, mount.yaw)
        if arm.any():
            drive.linear = drive.linear - _lever_velocity(drive, yaw, arm)
    drive.pose[:, :2] -= turn(np.broadcast_to(arm, (len(yaw), 2)), yaw)
    drive.pose[:, 2] = yaw


def _lever_velocity(drive: Drive, yaw: ndarray, arm: ndarray) -> ndarray:
    """Velocity [T, 2] of the tracker relative to the reference point, r x arm = (-r y, r x)."""
    rate = drive.yaw_rate
    if rate is None:
        known = drive.keep
        unwrapped = np.interp(drive.t, drive.t[known], np.unwrap(yaw[known]))
        rate = np.gradient(unwrapped, drive.t)
    return np.stack([-rate * arm[1], rate * arm[0]], -1)
