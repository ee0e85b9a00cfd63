"""The messages of one topic of a bag: values, stamps on one clock, and who published them."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.readers.bag_topics import numeric_fields
from buggy_rl.recordings.recording import RecordingError

STRAY = 0.01  # share of the messages below which another publisher's are left out; chosen
CLOCK_STEP = 0.5  # [s] by which a clock that is set forward moves; a hole in the stamps is shorter
WINDOW = 25  # messages on each side of a step of the clock, whose latency is compared
SAME = 0.1  # share of differing messages with equal stamps, from which stamps are worthless
LEAP = 0.05  # [m] between messages; at 100 Hz a car at 5 m/s moves as far
RETURNS = 1 / 3  # of a leap, within which a position is back at an earlier one
BACK = 10  # messages within which it is
ALTERNATING = 0.1  # share of returning leaps that two publishers make; glitches make fewer


class Publisher(NamedTuple):
    """Publisher of a message."""

    node: str
    """Name of the publishing node; only in bags of ROS 1."""
    child: str
    frame: str


@dataclass
class Series:
    """Messages of a topic, N of them in order of arrival."""

    topic: str
    arrival: ndarray
    """[N] s."""
    stamp: ndarray
    """[N] s, as in the header; 0 without."""
    values: ndarray
    """[N, fields]."""
    notes: list[str] = field(default_factory=list)
    row: ndarray = field(init=False)
    """[N] number of each message in the topic."""

    def __post_init__(self) -> None:
        self.row = np.arange(len(self.stamp))

    @property
    def stamped(self) -> bool:
        """Whether every message has a stamp."""
        return bool((self.stamp > 0).all())

    def keep(self, rows: ndarray) -> None:
        """Keeps the messages of a mask [N] alone."""
        self.arrival, self.stamp = self.arrival[rows], self.stamp[rows]
        self.values, self.row = self.values[rows], self.row[rows]


def read_series(
    path: Path, bag: Any, topic: str, fields: tuple[str, ...], source: str | None, option: str
) -> Series:
    """Reads fields of the messages of a topic.

    Args:
        path: Of the bag.
        bag: An open reader.
        topic: Its name.
        fields: Such as `pose.position.x` or `data[0]`.
        source: The node or frame whose messages are read; None where only one publishes.
        option: Of the column map, that names the source.

    Raises:
        RecordingError: The type is not defined, a field or all messages are missing, or several
            nodes publish the topic.
    """
    kind = bag.topics[topic].msgtype
    if kind not in bag.typestore.fielddefs:
        message = (
            f"the bag has no definition of {kind}, as bags in .db3 up to ROS 2 Humble have none; "
            "convert it where its package is installed: ros2 bag convert to mcap, or record -s mcap"
        )
        raise RecordingError(str(path), message, column=topic)
    getters = [_getter(name) for name in fields]
    arrival, stamp, values, sources = [], [], [], []
    connections = [c for c in bag.connections if c.topic == topic]
    for row, (connection, nanoseconds, raw) in enumerate(bag.messages(connections)):
        message = bag.deserialize(raw, connection.msgtype)
        arrival.append(nanoseconds)
        stamp.append(_stamp(message))
        sources.append(_source(connection, message))
        try:
            values.append([float(get(message)) for get in getters])
        except (AttributeError, IndexError, TypeError) as error:
            there = ", ".join(numeric_fields(bag.typestore, kind))
            text = f"the message has no {', '.join(fields)} ({error}); it has {there}: name two of "
            text += "them under topics.action_fields"
            raise RecordingError(str(path), text, row, topic) from error
    if not values:
        raise RecordingError(str(path), "the topic has no message; record again", column=topic)
    series = Series(
        topic,
        np.array(arrival, np.int64) * 1e-9,
        np.array(stamp, np.int64) * 1e-9,
        np.array(values, np.float64),
    )
    _one_source(path, series, sources, source, option)
    _mend_clock(series)
    _drop_equal_stamps(series)
    return series


def _getter(name: str) -> Callable[[Any], Any]:
    """Access to `a.b[1].c` of a message."""
    steps = re.findall(r"[A-Za-z_]\w*|\[\d+\]", name)

    def get(message: Any) -> Any:
        for step in steps:
            message = message[int(step[1:-1])] if step.startswith("[") else getattr(message, step)
        return message

    return get


def _stamp(message: Any) -> int:
    """Header stamp in ns; 0 for a message without."""
    header = getattr(message, "header", None)
    return 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec


def _source(connection: Any, message: Any) -> Publisher:
    frame = getattr(getattr(message, "header", None), "frame_id", "")
    node = getattr(connection.ext, "callerid", None) or ""
    return Publisher(node, getattr(message, "child_frame_id", ""), frame)


def _one_source(
    path: Path, series: Series, sources: list[Publisher], wanted: str | None, option: str
) -> None:
    """Keeps the messages of one publisher.

    Raises:
        RecordingError: The wanted one has none, or several publish at the same time.
    """
    count = Counter(sources)
    if wanted is not None:
        chosen = np.array([wanted in source for source in sources])
        if not chosen.any():
            text = f"no message is of {wanted!r}; correct topics.{option}; available: "
            there = dict.fromkeys(part for source in count for part in source)
            raise RecordingError(str(path), text + ", ".join(map(repr, there)), column=series.topic)
        series.keep(chosen)
        return
    often = sorted(source for source, n in count.items() if n >= STRAY * len(sources))
    if len(often) > 1 and _at_once(sources, often):
        part = next(i for i in range(3) if len({source[i] for source in often}) > 1)
        names = ", ".join(f"{s[part]!r} ({count[s]} messages)" for s in often)
        text = (
            f"{len(often)} publish this topic at the same time: {names}; choose one: "
            f"topics: {{{option}: {often[0][part]!r}}} in a column map"
        )
        raise RecordingError(str(path), text, column=series.topic)
    if len(often) < len(count):
        strays = np.array([source not in often for source in sources])
        text = f"{strays.sum()} messages of another publisher: cut"
        series.notes.append(f"column {series.topic}: {text}")
        series.keep(~strays)


def _at_once(sources: list[Publisher], often: list[Publisher]) -> bool:
    """Whether messages of several sources come in between one another."""
    runs = [s for i, s in enumerate(sources) if s in often and (not i or s != sources[i - 1])]
    return len(runs) > len(often)


def _mend_clock(series: Series) -> None:
    """Moves stamps after a step of their clock by as much as they moved against the arrival.

    A step is a stamp that runs back, or forward by more than `CLOCK_STEP`, while messages go on
    arriving, and a difference of both clocks that stays. Stamps that only come in another order
    are left as they are.
    """
    if not series.stamped or len(series.stamp) < 3:
        return
    for at in _steps(series):
        before, after = slice(max(0, at - WINDOW), at), slice(at, at + WINDOW)
        late = series.arrival - series.stamp
        moved = float(np.median(late[after]) - np.median(late[before]))
        step = float(series.stamp[at] - series.stamp[at - 1])
        if abs(moved) < 0.5 * abs(step):
            continue  # one message out of order
        series.stamp = np.where(np.arange(len(late)) >= at, series.stamp + moved, series.stamp)
        text = (
            f"the clock of the stamps was set {'back' if moved > 0 else 'forward'} by "
            f"{abs(moved):.6g} s: later stamps are moved by it, to go on with the arrival"
        )
        series.notes.append(f"row {series.row[at]}, column {series.topic}: {text}")


def _steps(series: Series) -> ndarray:
    """Messages [n] before which the clock may have been set."""
    step, arrived = np.diff(series.stamp), np.diff(series.arrival)
    ahead = (step > CLOCK_STEP) & (step - arrived > CLOCK_STEP)
    return np.flatnonzero((step < 0) | ahead) + 1


def _drop_equal_stamps(series: Series) -> None:
    """Drops stamps that many differing messages share, such as whole seconds."""
    if not series.stamped:
        return
    equal = np.diff(series.stamp) == 0
    differ = equal & (np.diff(series.values, axis=0) != 0).any(-1)
    if differ.mean() > SAME:
        series.notes.append(
            f"column {series.topic}: {differ.mean():.0%} of the messages have the stamp of the one "
            "before: stamps are not used"
        )
        series.stamp = np.zeros_like(series.stamp)


def refuse_two_paths(path: Path, series: Series) -> None:
    """Refuses positions, the first two values, that alternate between two paths.

    Two nodes may publish one topic under the same frame, which bags of ROS 2 do not tell apart; and
    a bag sorts what was recorded twice at one time, by a clock that was set back, in between.

    Raises:
        RecordingError: They do.
    """
    xy = series.values[:, :2]
    leap = np.linalg.norm(xy[1:] - xy[:-1], axis=-1)
    back = np.full(len(leap), np.inf)
    for earlier in range(2, min(BACK, len(xy) - 1) + 1):
        near = np.linalg.norm(xy[earlier:] - xy[:-earlier], axis=-1)
        back[earlier - 1 :] = np.minimum(back[earlier - 1 :], near)
    returned = (leap > LEAP) & (back < RETURNS * leap)
    if returned.mean() > ALTERNATING:
        apart = float(np.median(leap[returned]))
        text = (
            f"positions alternate between two paths {apart:.2g} m apart ({returned.mean():.0%} of "
            "the messages): two nodes publish this topic, or the recorder's clock was set back; "
            "record one node alone (or under a topic of its own, named by topics.odometry), "
            "without setting the clock"
        )
        raise RecordingError(
            str(path), text, int(series.row[np.argmax(returned) + 1]), series.topic
        )
