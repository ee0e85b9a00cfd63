"""From the columns of a file to SI units, body frame and commands in [-1, 1]."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.checks.cells import QUATERNION, check_cells, check_quaternions
from buggy_rl.recordings.checks.commands import clip_commands
from buggy_rl.recordings.columns import BESIDE, CHANNELS, QUANTITY, UNITS, ColumnMap
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.raw_recording import RawRecording, rotate
from buggy_rl.recordings.readers import Table

NEEDED = ("t", "x", "y", "throttle", "steering")
FAR = 1e4  # [m] from the origin, where float32 resolves 1 mm; on a UTM grid it resolves 0.5 m
GRID = 1000.0  # [m]
CLOCK_ORIGIN = 1e6  # [s] stamps above this, 11 days, count from 1970 and not from a start


def map_columns(table: Table, columns: ColumnMap) -> RawRecording:
    """Converts a table with its column map.

    Raises:
        RecordingError: A column is missing or not numeric, a quaternion is invalid, or a command
            is outside its range.
    """
    names = _present(table, columns)
    beside = {channel: names.pop(channel) for channel in BESIDE if channel in names}
    labels = {channel: table.label(name) for channel, name in names.items()}
    dropped = _leading_rows(table, columns)
    values = {channel: table.numbers(name)[dropped:] for channel, name in names.items()}
    factor = _factor(table, columns)
    row = (np.arange(len(table)) if table.rows is None else table.rows)[dropped:]
    row = row + table.first_row
    missing = check_cells(table.file, values, labels, row, columns.limits)
    check_quaternions(table.file, values, labels, row, columns.limits)
    si = {channel: _si(channel, column, columns) for channel, column in values.items()}
    raw = RawRecording(
        file=table.file,
        t=si["t"] - (si["t"][0] if columns.time_from_first else 0.0),
        pose=np.stack([si["x"], si["y"], _yaw(si, columns)], -1),
        linear=np.stack([si["vx"], si["vy"]], -1) if "vx" in si and "vy" in si else None,
        yaw_rate=si.get("yaw_rate"),
        action=np.stack([si["throttle"], si["steering"]], -1),
        row=row,
        labels=labels | ({} if "yaw" in si else {"yaw": ", ".join(labels[q] for q in QUATERNION)}),
        notes=list(table.notes),
        beside={c: _si(c, table.numbers(name)[dropped:], columns) for c, name in beside.items()},
        reverse=columns.command.two_way,
    )
    _note_reading(raw, dropped, columns, si)
    for channel, cells in missing.items():
        raw.cut(cells, channel, "no value (NaN), the tracker lost the car")
    clip_commands(raw, columns, None if factor is None else factor[dropped:])
    _to_reference_point(raw, columns)
    _near_origin(raw)
    return raw


def _present(table: Table, columns: ColumnMap) -> dict[str, str]:
    """Channel -> column, of the channels in the file."""
    ignored = set(columns.ignore)
    names = {channel: columns.names.get(channel, channel) for channel in (*CHANNELS, *BESIDE)}
    there = {c: n for c, n in names.items() if n in table.columns and n not in ignored}
    stated = [names[c] for c in columns.names if c not in there and names[c] not in ignored]
    missing = [names[c] for c in NEEDED if c not in there]
    if "yaw" not in there and not all(q in there for q in QUATERNION):
        missing.append(f"{names['yaw']} (or {', '.join(names[q] for q in QUATERNION)})")
    missing += [n for n in stated if n not in missing]
    if missing:
        raise _missing(table, ", ".join(missing))
    if "yaw" in there:
        there = {c: n for c, n in there.items() if c not in QUATERNION}
    return there


def _missing(table: Table, names: str) -> RecordingError:
    message = f"missing; available: {', '.join(table.columns)}; name the columns in a column map"
    return RecordingError(table.file, message, column=names)


def _leading_rows(table: Table, columns: ColumnMap) -> int:
    """Number of leading rows to drop."""
    drop = columns.drop_leading
    if drop.column is None:
        return 0
    if drop.column not in table.columns:
        raise _missing(table, drop.column)
    waiting = table.numbers(drop.column) == drop.equals
    if waiting.all():
        message = f"{drop.equals:g} in all rows; correct drop_leading in the column map"
        raise RecordingError(table.file, message, 0, drop.column)
    return int(np.argmin(waiting))


def _factor(table: Table, columns: ColumnMap) -> ndarray | None:
    name = columns.throttle.factor
    if name is None:
        return None
    if name not in table.columns:
        raise _missing(table, name)
    factor = table.numbers(name)
    bad = ~np.isfinite(factor)
    if bad.any():
        at = int(np.argmax(bad))
        message = f"{factor[at]} is not finite; correct it, or omit throttle.factor"
        raise RecordingError(table.file, message, at + table.first_row, name)
    return factor


def _si(channel: str, values: ndarray, columns: ColumnMap) -> ndarray:
    unit = columns.units.get(channel)
    factor = UNITS[QUANTITY[channel]][unit] if unit else 1.0
    return values * (factor * columns.signs.get(channel, 1.0))


def _yaw(si: Mapping[str, ndarray], columns: ColumnMap) -> ndarray:
    """Yaw [T] rad: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2)) of a unit quaternion."""
    if "yaw" in si:
        return si["yaw"]
    w, x, y, z = (si[q] for q in QUATERNION)
    sign = columns.signs.get("yaw", 1.0)
    return sign * np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _note_reading(raw: RawRecording, dropped: int, columns: ColumnMap, si: Mapping) -> None:
    if dropped:
        drop, first = columns.drop_leading, int(raw.row[0])
        text = f"rows {first - dropped}-{first - 1}, column {drop.column}: {drop.equals:g}: dropped"
        raw.notes.append(text)
    if ("vx" in si) != ("vy" in si):
        raw.note_column("vx" if "vx" in si else "vy", "not used, the other of vx, vy is missing")
    if columns.time_from_first and si["t"][0] > CLOCK_ORIGIN:
        raw.note_column("t", f"counted from {si['t'][0]:.3f} s")


def _to_reference_point(raw: RawRecording, columns: ColumnMap) -> None:
    """Moves pose and velocity from the tracker to the car's reference point."""
    mount = columns.mount
    yaw = raw.pose[:, 2] - mount.yaw
    arm = np.array([mount.x, mount.y])
    if raw.linear is not None:
        raw.linear = rotate(raw.linear, -yaw if columns.velocity_frame == "world" else mount.yaw)
        if arm.any():
            raw.linear = raw.linear - _lever_velocity(raw, yaw, arm)
    raw.pose[:, :2] -= rotate(np.broadcast_to(arm, (len(yaw), 2)), yaw)
    raw.pose[:, 2] = yaw


def _near_origin(raw: RawRecording) -> None:
    """Moves positions on a map's grid near the origin, where single precision resolves them.

    By whole kilometres, so that recordings of one place keep the same frame.
    """
    known = raw.keep & np.isfinite(raw.pose[:, :2]).all(-1)
    if not known.any():
        return
    middle = np.median(raw.pose[known, :2], axis=0)
    if np.abs(middle).max() < FAR:
        return
    moved = GRID * np.round(middle / GRID)
    raw.pose[:, :2] -= moved
    raw.note_column("x", f"positions count from ({moved[0]:.0f}, {moved[1]:.0f}) m")


def _lever_velocity(raw: RawRecording, yaw: ndarray, arm: ndarray) -> ndarray:
    """Velocity [T, 2] of the tracker relative to the reference point, r x arm = (-r y, r x)."""
    rate = raw.yaw_rate
    if rate is None:
        known = raw.keep
        unwrapped = np.interp(raw.t, raw.t[known], np.unwrap(yaw[known]))
        rate = np.gradient(unwrapped, raw.t)
    return np.stack([-rate * arm[1], rate * arm[0]], -1)
