"""Converts the columns of a file to SI units, body frame and commands in [-1, 1]."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.checks.cells import check_cells
from buggy_rl.recordings.checks.commands import clip_commands
from buggy_rl.recordings.checks.heading import check_quaternions
from buggy_rl.recordings.columns import (
    BESIDE,
    CHANNELS,
    QUANTITY,
    QUATERNION,
    UNITS,
    ColumnMap,
    Throttle,
)
from buggy_rl.recordings.raw_recording import RawRecording, rotate_rows
from buggy_rl.recordings.readers import Table
from buggy_rl.recordings.readers.interleaved import merged_by_time
from buggy_rl.recordings.recording import RecordingError
from buggy_rl.recordings.stamps import CLOCK_ORIGIN, unwound

NEEDED = ("t", "x", "y", "throttle", "steering")
COMMENT_SIGNS = "#%/ "  # before a header that is a comment; names in a map may have them


def present(table: Table, columns: ColumnMap) -> tuple[dict[str, str], dict[str, str]]:
    """Channel -> column, of the channels in the file; those of sensors beside apart.

    Names in capitals are those of channels where a needed one is not there otherwise.

    Raises:
        RecordingError: A needed channel, or a column that the map names, is missing.
    """
    ignored = set(columns.ignore)
    channels = (*CHANNELS, *BESIDE)
    needed = [c for c in NEEDED if c != "t" or columns.rate is None]
    names = {channel: _named(table, channel, columns) for channel in channels}
    if not all(names[channel] in table.columns for channel in needed):
        names = {c: n if n in table.columns else _alike(table, c, n) for c, n in names.items()}
    there = {c: n for c, n in names.items() if n in table.columns and n not in ignored}
    stated = [names[c] for c in columns.names if c not in there and names[c] not in ignored]
    missing = [names[c] for c in needed if c not in there]
    if "yaw" not in there and not all(q in there for q in QUATERNION):
        missing.append(f"{names['yaw']} (or {', '.join(names[q] for q in QUATERNION)})")
    missing += [n for n in stated if n not in missing]
    if missing:
        raise missing_columns(table, ", ".join(missing))
    if "yaw" in there:
        there = {c: n for c, n in there.items() if c not in QUATERNION}
    other = {c: n for c, n in there.items() if n.lower() == c != n and c not in columns.names}
    if other:
        table.notes.append(f"columns {', '.join(other.values())} are read as {', '.join(other)}")
    beside = {channel: there.pop(channel) for channel in BESIDE if channel in there}
    return {"t": "t", **there} if columns.rate else there, beside


def _named(table: Table, channel: str, columns: ColumnMap) -> str:
    """The column of a channel by the map, where it may have the sign of a comment before it."""
    name = columns.names.get(channel, channel)
    bare = name.lstrip(COMMENT_SIGNS)
    return bare if bare in table.columns and name not in table.columns else name


def _alike(table: Table, channel: str, name: str) -> str:
    """The only column that has a channel's name in capitals, else the name given."""
    alike = [column for column in table.columns if column.lower() == channel]
    return alike[0] if len(alike) == 1 and name == channel else name


def missing_columns(table: Table, names: str) -> RecordingError:
    """The error of columns that are not in a table, with those that are."""
    there = ", ".join(table.columns)
    what = "name the columns in a column map, or let scripts/inspect_recordings.py propose one"
    if table.headerless:
        there = f"no header line, columns by their position: 0 to {len(table.columns) - 1}"
        what = (
            "name them by their position in a column map, such as names: {x: 4}, or let "
            "scripts/inspect_recordings.py propose one"
        )
    message = f"missing; available: {there}; {what}"
    return RecordingError(table.file, message, column=names)


FAR = 1e4  # [m] from the origin, where float32 resolves 1 mm; on a UTM grid it resolves 0.5 m
GRID = 1000.0  # [m]
DRIVES = 0.1  # [m, or the file's unit] of position that a car which stands does not cover


def map_columns(table: Table, columns: ColumnMap) -> RawRecording:
    """Converts a table with its column map.

    Raises:
        RecordingError: A column is missing or not numeric, a quaternion is invalid, or a command
            is outside its range.
    """
    names, beside = present(table, columns)
    table = _merged(table, {**names, **beside}, columns)
    labels = {channel: table.label(name) for channel, name in names.items()}
    dropped = _leading_rows(table, columns)
    read = [c for c in names if c != "t" or columns.rate is None]
    values = {channel: table.numbers(names[channel])[dropped:] for channel in read}
    factor = _factor(table, columns)
    row = table.file_rows[dropped:]
    missing = check_cells(table.file, values, labels, row, columns.limits)
    _refuse_one_command(table, values, labels)
    check_quaternions(table, values, labels, row, columns.limits)
    si = {channel: _si(channel, column, columns) for channel, column in values.items()}
    si["t"], jumps = unwound(_stamps(table, names, columns)[dropped:])
    measured = not columns.derive_velocity
    raw = RawRecording(
        file=table.file,
        t=si["t"] - (si["t"][0] if columns.time_from_first else 0.0),
        pose=np.stack([si["x"], si["y"], _yaw(si, columns)], -1),
        linear=np.stack([si["vx"], si["vy"]], -1) if measured and {"vx", "vy"} <= set(si) else None,
        yaw_rate=si.get("yaw_rate") if measured else None,
        action=np.stack([si["throttle"], si["steering"]], -1),
        row=row,
        labels=labels | ({} if "yaw" in si else {"yaw": ", ".join(labels[q] for q in QUATERNION)}),
        notes=list(table.notes),
        beside={c: _si(c, table.numbers(name)[dropped:], columns) for c, name in beside.items()},
        reverse=columns.command.two_way,
        rest_declared=columns.throttle != Throttle() or columns.command.kind != "throttle",
    )
    raw.starts[[jump.row for jump in jumps]] = True
    raw.starts[[start - dropped for start in table.starts if start > dropped]] = True
    for jump in jumps:
        raw.note(np.array([jump.row]), "t", f"{jump}: two segments, the stamps count on: cut there")
    _note_reading(raw, dropped, columns, si)
    for channel, cells in missing.items():
        raw.cut(cells, channel, "no value (NaN), the tracker lost the car")
    clip_commands(raw, columns, None if factor is None else factor[dropped:])
    _to_reference_point(raw, columns)
    _near_origin(raw)
    return raw


def _merged(table: Table, names: Mapping[str, str], columns: ColumnMap) -> Table:
    """The table with the rows of several sources merged by time."""
    read = {c: n for c, n in names.items() if c != "t"}
    if columns.throttle.factor in table.columns:
        read["throttle factor"] = str(columns.throttle.factor)
    turn = 360.0 if columns.units.get("yaw") == "deg" else 2 * np.pi
    return merged_by_time(table, read, _stamps(table, names, columns), columns.limits, turn)


def _stamps(table: Table, names: Mapping[str, str], columns: ColumnMap) -> ndarray:
    """Stamps [T] s."""
    if columns.rate is not None:
        return table.file_rows / columns.rate
    return _si("t", table.numbers(names["t"]), columns)


def _refuse_one_command(
    table: Table, values: Mapping[str, ndarray], labels: Mapping[str, str]
) -> None:
    """Throttle and steering are two columns.

    Raises:
        RecordingError: They are one column, or the same numbers in a drive.
    """
    throttle, steering = values["throttle"], values["steering"]
    drives = max(float(np.nanmax(values[c]) - np.nanmin(values[c])) for c in ("x", "y")) > DRIVES
    one = labels["throttle"] == labels["steering"]
    if np.array_equal(throttle, steering) and (one or (drives and np.ptp(throttle) > 0)):
        message = (
            "throttle and steering are the same numbers in all rows; name the column of each in a "
            "column map"
        )
        both = f"{labels['throttle']}, {labels['steering']}"
        raise RecordingError(table.file, message, column=both)


def _leading_rows(table: Table, columns: ColumnMap) -> int:
    """Number of leading rows to drop."""
    drop = columns.drop_leading
    if drop.column is None:
        return 0
    if drop.column not in table.columns:
        raise missing_columns(table, drop.column)
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
        raise missing_columns(table, name)
    factor = table.numbers(name)
    bad = ~np.isfinite(factor)
    if bad.any():
        at = int(np.argmax(bad))
        message = f"{factor[at]} is not finite; correct it, or omit throttle.factor"
        raise RecordingError(table.file, message, int(table.file_rows[at]), name)
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
        raw.linear = rotate_rows(
            raw.linear, -yaw if columns.velocity_frame == "world" else mount.yaw
        )
        if arm.any():
            raw.linear = raw.linear - _lever_velocity(raw, yaw, arm)
    raw.pose[:, :2] -= rotate_rows(np.broadcast_to(arm, (len(yaw), 2)), yaw)
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
