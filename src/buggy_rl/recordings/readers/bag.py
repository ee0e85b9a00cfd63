"""ROS 1 and ROS 2 bags: one topic with the pose and one, or two, with the commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from buggy_rl.core.extras import needs
from buggy_rl.recordings.columns import ColumnMap, SteeringRange
from buggy_rl.recordings.readers.bag_series import Series, read_series, refuse_two_paths
from buggy_rl.recordings.readers.bag_topics import (
    ACKERMANN,
    POSE_FIELDS,
    WHEEL_SPEED,
    command_fields,
    known_types,
    pose_topic,
    wheel_topic,
)
from buggy_rl.recordings.readers.layout import Table
from buggy_rl.recordings.recording import RecordingError

CLOCK_DISTANCE = 0.5  # [s] between stamp and arrival of one clock; a slow network is faster
OLD_COMMAND = 0.5  # [s] age of a command that is noted; a joystick may be silent for longer
BRIDGED = 0.1  # [s] from a message of the wheel speed, beyond which there is no value; 10 Hz
ALONE = ".mcap", ".db3"
"""Endings of a ROS 2 bag's file, which can be read without its folder."""


def is_bag(path: Path) -> bool:
    """Whether this is a ROS 1 bag, the folder of a ROS 2 bag, or the file of one."""
    if path.is_dir():
        there = any(path.glob("*.db3*")) or any(path.glob("*.mcap*"))
        return there and (path / "metadata.yaml").is_file()
    return path.suffix.lower() in (".bag", *ALONE)


def files_alone(folder: Path) -> list[Path]:
    """Files of ROS 2 bags in a folder without metadata, each a bag by itself; sorted."""
    if not folder.is_dir() or (folder / "metadata.yaml").is_file():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in ALONE)


def read_bag(path: Path, columns: ColumnMap) -> Table:
    """Reads the messages of a pose, each with the last commands at or before its stamp.

    Raises:
        RecordingError: The bag cannot be read, a topic is missing or ambiguous, or two nodes
            publish it.
    """
    needs("rosbags", "bags", f"reading the bag {path}")
    from rosbags.highlevel import AnyReader

    alone = files_alone(path)
    if len(alone) > 1:
        message = f"{len(alone)} files without metadata.yaml; read them one by one, or run "
        raise RecordingError(str(path), message + f"ros2 bag reindex {path}")
    path, types = alone[0] if alone else path, known_types()
    try:
        with AnyReader([path], default_typestore=types) as bag:
            there = bag.typestore.fielddefs  # a bag may define some of its types only
            bag.typestore.register({n: d for n, d in types.fielddefs.items() if n not in there})
            return _table(path, bag, columns)
    except RecordingError:
        raise
    except Exception as error:  # rosbags lets errors of sqlite, YAML, struct and lz4 through
        message = f"the bag cannot be read ({error!r}); repair it with the ROS bag tools"
        raise RecordingError(str(path), message) from error


def _table(path: Path, bag: Any, columns: ColumnMap) -> Table:
    odometry, notes = pose_topic(path, bag, columns.topics)
    fields = POSE_FIELDS[bag.topics[odometry].msgtype]
    only = columns.topics.odometry_source
    poses = read_series(path, bag, odometry, tuple(fields.values()), only, "odometry_source")
    refuse_two_paths(path, poses)
    commands = _Commands.read(path, bag, columns)
    wheels = _wheels(path, bag)
    series = [poses, *commands.series.values(), *([wheels] if wheels else [])]
    stamps, more = _times(poses, series[1:])
    notes += [note for each in series for note in each.notes] + more
    unique = _unique(poses, stamps[odometry], notes)
    t = stamps[odometry][unique]
    held, known = commands.held(path, stamps, t, notes)
    table = {name: poses.values[unique, place] for place, name in enumerate(fields)}
    table |= {"t": t, **held}
    if wheels:
        table["wheel_speed"] = _near(stamps[wheels.topic], wheels.values[:, 0], t)
    labels = {name: f"{odometry}.{field}" for name, field in fields.items()}
    labels |= {"t": odometry, **commands.labels}
    notes += _without_ranges(bag, commands, columns)
    columns_of_rows = {name: values[known] for name, values in table.items()}
    return Table(str(path), columns_of_rows, labels, notes, rows=poses.row[unique][known])


@dataclass(frozen=True)
class _Commands:
    """Throttle and steering, of one topic or of one each."""

    places: dict[str, tuple[str, str]]
    """Channel -> topic and field."""
    series: dict[str, Series]
    """Series by topic; its values are those of its channels, in their order."""

    @classmethod
    def read(cls, path: Path, bag: Any, columns: ColumnMap) -> "_Commands":
        """Reads what a column map names, or the only topic that can be it."""
        topics, only = columns.topics, columns.topics.action_source
        throttle, steering = command_fields(path, bag, topics)
        places = {"throttle": throttle, "steering": steering}
        series = {}
        for topic in dict.fromkeys(topic for topic, _ in places.values()):
            fields = tuple(field for name, field in places.values() if name == topic)
            series[topic] = read_series(path, bag, topic, fields, only, "action_source")
        return cls(places, series)

    @property
    def labels(self) -> dict[str, str]:
        """Channel -> `topic.field`."""
        return {channel: f"{topic}.{field}" for channel, (topic, field) in self.places.items()}

    def held(
        self, path: Path, stamps: Mapping[str, ndarray], t: ndarray, notes: list[str]
    ) -> tuple[dict[str, ndarray], ndarray]:
        """Commands [T] at times [T], the last at or before each, and which rows have all of them.

        Raises:
            RecordingError: All commands of a topic come after the last time, or are old.
        """
        known, result = np.ones(len(t), bool), {}
        for topic, series in self.series.items():
            order = np.argsort(stamps[topic], kind="stable")
            last = np.searchsorted(stamps[topic][order], t, side="right") - 1
            at = order[np.maximum(last, 0)]
            _check_age(path, topic, t - stamps[topic][at], last >= 0, notes)
            known &= last >= 0
            channels = [channel for channel, (name, _) in self.places.items() if name == topic]
            result |= {channel: series.values[at, i] for i, channel in enumerate(channels)}
        return result, known


def _check_age(path: Path, topic: str, age: ndarray, known: ndarray, notes: list[str]) -> None:
    """Refuses commands of another clock; notes rows without one, and old ones."""
    if not known.any():
        message = "all commands are stamped after the last odometry message; use one clock for both"
        raise RecordingError(str(path), message, 0, topic)
    age = age[known]
    if age.min() > OLD_COMMAND:
        message = f"all commands are at least {age.min():.1f} s old; use one clock for both topics"
        raise RecordingError(str(path), message, 0, topic)
    if not known.all():
        notes.append(f"first {(~known).sum()} rows, column {topic}: no command yet: cut")
    if age.max() > OLD_COMMAND:
        notes.append(f"column {topic}: commands are up to {age.max():.2f} s old")


def _times(poses: Series, others: Sequence[Series]) -> tuple[dict[str, ndarray], list[str]]:
    """Topic -> times [s] on one clock: the stamps, otherwise the times of arrival."""
    distance = float(np.median(np.abs(poses.stamp - poses.arrival)))
    unstamped = [series for series in others if not series.stamped]
    if poses.stamped and (not unstamped or distance < CLOCK_DISTANCE):
        times = {s.topic: s.stamp if s.stamped else s.arrival for s in others}
        return {**times, poses.topic: poses.stamp}, []
    times = {series.topic: series.arrival for series in (*others, poses)}
    return times, ["column t: time of arrival, not of stamp"]


def _unique(poses: Series, t: ndarray, notes: list[str]) -> ndarray:
    """Messages [n] in order of their times [N], the first of those at the same time."""
    order = np.argsort(t, kind="stable")
    equal = np.diff(t[order], prepend=-np.inf) == 0
    if not equal.any():
        return order
    same = poses.values[order][1:] == poses.values[order][:-1]
    differ = int((equal[1:] & ~same.all(-1)).sum())
    what = f", {differ} of which differ from it" if differ else ""
    text = f"{equal.sum()} messages have the stamp of the one before{what}: cut"
    notes.append(f"column {poses.topic}: {text}")
    return order[~equal]


def _wheels(path: Path, bag: Any) -> Series | None:
    """The speed of the motor, where one topic has it."""
    topic = wheel_topic(bag)
    if topic is None:
        return None
    return read_series(path, bag, topic, (WHEEL_SPEED[bag.topics[topic].msgtype],), None, "")


def _near(stamps: ndarray, values: ndarray, t: ndarray) -> ndarray:
    """Values [T] interpolated at times [T]; NaN farther than `BRIDGED` from a stamp."""
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], values[order]
    after = np.searchsorted(stamps, t).clip(0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    apart = np.maximum(np.abs(stamps[after] - t), np.abs(t - stamps[before]))
    return np.where(apart <= BRIDGED, np.interp(t, stamps, values), np.nan)


def _without_ranges(bag: Any, commands: _Commands, columns: ColumnMap) -> list[str]:
    """A note where the type states units, and the column map does not state the ends."""
    kinds = {
        bag.topics[topic].msgtype.removesuffix("Stamped") for topic, _ in commands.places.values()
    }
    stated = columns.throttle != ColumnMap(command=columns.command).throttle
    if ACKERMANN not in kinds or (stated and columns.steering != SteeringRange()):
        return []
    return [
        f"column {', '.join(commands.series)}: {ACKERMANN} has a speed in m/s and the angle of the "
        "wheels in rad: if so, state command: {kind: speed, full_speed: 5}, throttle: {rest: 0, "
        "full: 5} and steering: {right: -0.4, left: 0.4}, with the ends of this car"
    ]
