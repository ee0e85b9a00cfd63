"""A column map as text, each line with the evidence it was guessed from."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence

from buggy_rl.inspection.columns import Guess, exchanged, own_name
from buggy_rl.inspection.coverage import UNKNOWN, seen, seen_at_rest, steering_ends, throttle_ends
from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.signals import qualified
from buggy_rl.recordings.mapping import CLOCK_ORIGIN

HEAD = (
    "# Proposed by scripts/inspect_recordings.py: guesses from the data of {count} drives, with",
    "# the evidence of each. Check and edit it; nothing reads it by itself. Then:",
    "#   python scripts/check_recordings.py FOLDER columns=THIS_FILE",
)
EXCHANGED = (
    "throttle and steering are exchanged: the path bends with the column that is named as the "
    "throttle, and the car speeds up with the other"
)
TELLING = {
    "gyro": ("yaw_rate", re.compile(r"gyro|imu|angular", re.IGNORECASE), "how late the pose is"),
    "wheel_speed": ("vx", re.compile(r"wheel|enc|rpm|odom", re.IGNORECASE), "how wheels slip"),
}
"""Sensor beside the tracker -> the rate it measures, names of its columns, what it tells."""


def chosen_commands(drives: Sequence[DriveFacts]) -> dict[str, Guess]:
    """Channel -> the column that most drives agree on, with the evidence of the best of them."""
    result = {}
    for channel in ("steering", "throttle"):
        votes: dict[str, list[Guess]] = defaultdict(list)
        for drive in drives:
            guess: Guess | None = getattr(drive, channel)
            if guess is not None:
                votes[guess.column].append(guess)
        if votes:
            guesses = max(votes.values(), key=len)
            strongest = max(guesses, key=lambda guess: guess.strength)
            result[channel] = strongest
    return result


def _typical(drives: Sequence[DriveFacts]) -> DriveFacts | None:
    """The longest drive with a pose: its columns stand for all."""
    posed = [d for d in drives if d.pose is not None]
    return max(posed, key=lambda d: d.pose.clock.seconds if d.pose else 0.0, default=None)


def proposal(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> str:
    """The column map as YAML."""
    lines = [line.format(count=len(drives)) for line in HEAD]
    drive = _typical(drives)
    if drive is None or drive.pose is None or drive.raw is None:
        return "\n".join([*lines, "# No drive has a position that moves along a heading."]) + "\n"
    if exchanged(commands):
        lines += ["", f"# {EXCHANGED}"]
    lines += _tables(drive, commands)
    lines += _names(drive, commands)
    lines += _units(drive)
    if drive.pose.sign < 0:
        lines.append("signs: {yaw: -1}")
    if drive.pose.clock.t[0] > CLOCK_ORIGIN:
        lines += ["", "time_from_first: true  # stamps count from 1970"]
    lines += _ranges(drives, commands)
    notes = sorted({note for d in drives for note in d.notes if "accelerations" in note})
    lines += [f"# {note}" for note in notes[:1]]
    return "\n".join(lines) + "\n"


def _tables(drive: DriveFacts, commands: dict[str, Guess]) -> list[str]:
    assert drive.raw is not None
    assert drive.pose is not None
    if not drive.raw.several:
        return []
    used = [drive.pose.table, *(guess.column.partition(".")[0] for guess in commands.values())]
    used += [guess.column.partition(".")[0] for guess in drive.rates.get("yaw_rate", [])[:1]]
    used += [guess.column.partition(".")[0] for guess in _beside(drive).values()]
    lines = ["", "tables:  # rows are those of the first"]
    for table in dict.fromkeys(used):
        clock = drive.clocks[table]
        time = ", ".join(f"{_quoted(column)}: {unit}" for column, unit in clock.columns.items())
        file = drive.raw.files[table]
        lines.append(f"  - {{file: {file}, time: {{{time}}}}}  # {clock.evidence}")
    return lines


def _names(drive: DriveFacts, commands: dict[str, Guess]) -> list[str]:
    assert drive.raw is not None
    assert drive.pose is not None
    pose, lines = drive.pose, ["", "names:"]
    if not drive.raw.several:
        clock = pose.clock
        lines += [f"  t: {_quoted(next(iter(clock.columns)))}  # {clock.evidence}"]
    there = drive.raw.tables[pose.table].columns
    for channel, column in pose.names.items():
        if column in there:
            evidence = f"  # {pose.evidence}" if channel in ("yaw", "qw") else ""
            lines.append(f"  {channel}: {_quoted(qualified(pose.table, column))}{evidence}")
    lines += [
        f"  # or {qualified(o.table, o.names['x'])}: mean cosine {o.cosine:.3f}"
        for o in drive.others[:2]
    ]
    for channel, guess in commands.items():
        lines.append(f"  {channel}: {_quoted(guess.column)}  # {guess.evidence}")
    for guess in drive.rates.get("yaw_rate", [])[:1]:
        lines.append(f"  yaw_rate: {_quoted(guess.column)}  # {guess.evidence}")
    for guess in [g for g in drive.rates.get("vx", []) if g.column != "vx"][:1]:
        lines.append(f"  # vx: {_quoted(guess.column)}  # {guess.evidence}; needs vy beside it")
    for channel, guess in _beside(drive).items():
        lines.append(f"  {channel}: {_quoted(guess.column)}  # tells {TELLING[channel][2]}")
    return lines


def _beside(drive: DriveFacts) -> dict[str, Guess]:
    """Sensors beside the tracker, by their columns' names and what they go with."""
    found = {
        channel: [g for g in drive.rates.get(rate, []) if named.search(own_name(g.column))]
        for channel, (rate, named, _) in TELLING.items()
    }
    return {channel: guesses[0] for channel, guesses in found.items() if guesses}


def _units(drive: DriveFacts) -> list[str]:
    assert drive.pose is not None
    units, signs = {}, {}
    if "t" not in drive.pose.names and drive.raw is not None and not drive.raw.several:
        unit = next(iter(drive.pose.clock.columns.values()))
        if unit != "s":
            units["t"] = unit
    if drive.pose.unit != "m":
        units["x"] = units["y"] = drive.pose.unit
    if drive.pose.degrees:
        units["yaw"] = "deg"
    measured = [("yaw_rate", guess) for guess in drive.rates.get("yaw_rate", [])[:1]]
    for channel, guess in [*measured, *_beside(drive).items()]:
        if guess.unit not in ("rad/s", "m/s"):
            units[channel] = guess.unit
        if guess.sign < 0:
            signs[channel] = -1
    lines = []
    for name, values in (("units", units), ("signs", signs)):
        if values:
            text = ", ".join(f"{channel}: {value}" for channel, value in values.items())
            lines.append(f"{name}: {{{text}}}")
    return lines


def _ranges(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> list[str]:
    """Ends of the commands; `???` where a value was reached but shows no end."""
    lines = [""]
    if "throttle" in commands:
        guess = commands["throttle"]
        ends = throttle_ends(drives, guess)
        what = " a speed setpoint in m/s;" if guess.unit == "m/s" else ""
        rest = "while standing" if seen_at_rest(drives, guess) else "a guess, the car never stands"
        why = f"rest: {rest};{what} {_ends_words(ends)}{seen(drives, 'throttle', guess)}"
        lines.append(f"throttle: {_flow(ends)}  # {why}")
        lines += _command(drives, guess, ends)
    if "steering" in commands:
        guess = commands["steering"]
        ends = steering_ends(drives, guess)
        words = _ends_words(ends)
        lines.append(f"steering: {_flow(ends)}  # {words}{seen(drives, 'steering', guess)}")
    return lines


def _flow(ends: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{name}: {value}" for name, value in ends.items()) + "}"


def _ends_words(ends: Mapping[str, str]) -> str:
    return f"write the car's own for {UNKNOWN}; " if UNKNOWN in ends.values() else ""


def _command(drives: Sequence[DriveFacts], throttle: Guess, ends: Mapping[str, str]) -> list[str]:
    """The kind of the first command, where the car reverses under values below rest."""
    backward = max((d.pose.backward for d in drives if d.pose and d.pose.reverses), default=0.0)
    if not backward or "lowest" not in ends:
        return []
    kind = "throttle_brake_reverse"
    if throttle.unit == "m/s":
        kind = f"speed, reverse: true, full_speed: {ends['full']}"
    why = f"the car drives backward in up to {backward:.0%} of the moving time"
    return [f"command: {{kind: {kind}}}  # {why}; or kind: current"]


def _quoted(name: str) -> str:
    """A column's name as YAML."""
    plain = name.replace(".", "").replace("_", "").isalnum() and not name[:1].isdigit()
    return (
        name if plain and name.lower() not in ("y", "n", "yes", "no", "on", "off") else f'"{name}"'
    )
