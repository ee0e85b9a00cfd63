"""Which column of a table is which channel."""

from buggy_rl.recordings.columns import BESIDE, CHANNELS, QUATERNION, ColumnMap
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers import Table

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
