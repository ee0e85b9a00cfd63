"""ROS 1 and ROS 2 bags: one odometry topic and one topic of commands."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import Topics
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.table import Table

ODOMETRY = "nav_msgs/msg/Odometry"

ACTION_FIELDS = {
    "geometry_msgs/msg/Vector3": ("x", "y"),
    "geometry_msgs/msg/Vector3Stamped": ("vector.x", "vector.y"),
    "geometry_msgs/msg/Twist": ("linear.x", "angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.angular.z"),
    "std_msgs/msg/Float32MultiArray": ("data[0]", "data[1]"),
    "std_msgs/msg/Float64MultiArray": ("data[0]", "data[1]"),
    "sensor_msgs/msg/Joy": ("axes[0]", "axes[1]"),
}
"""Message type -> where throttle and steering are, unless the column map says otherwise."""

ODOMETRY_FIELDS = {
    "x": "pose.pose.position.x",
    "y": "pose.pose.position.y",
    "qw": "pose.pose.orientation.w",
    "qx": "pose.pose.orientation.x",
    "qy": "pose.pose.orientation.y",
    "qz": "pose.pose.orientation.z",
    "vx": "twist.twist.linear.x",
    "vy": "twist.twist.linear.y",
    "yaw_rate": "twist.twist.angular.z",
}
"""Channel -> field; the twist of an odometry message is in the body frame by its definition."""

CLOCK_DISTANCE = 0.5  # [s] stamps this far from the time of arrival come from another clock
OLD_COMMAND = 0.5  # [s] a joystick may be silent while nothing changes, but it is said


def is_bag(path: Path) -> bool:
    """Whether this is a ROS 1 bag file or the folder of a ROS 2 bag, complete or not."""
    if path.is_dir():
        return any(path.glob("*.db3*")) or any(path.glob("*.mcap*"))
    return path.suffix == ".bag"


def read_bag(path: Path, topics: Topics) -> Table:
    """Reads odometry, and for every message of it the last command at or before its stamp.

    Raises:
        RecordingError: The bag cannot be read, or a topic is missing or ambiguous.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            return _table(path, bag, topics)
    except RecordingError:
        raise
    except Exception as error:  # rosbags lets errors of sqlite, YAML, struct and lz4 through
        raise RecordingError(
            *(str(path), None, None, f"the bag cannot be read ({error!r})"),
            "repair it with the ROS bag tools, or record again",
        ) from error


def _table(path: Path, bag: Any, topics: Topics) -> Table:
    odometry = _choose(path, bag, topics.odometry, (ODOMETRY,), "odometry")
    action = _choose(path, bag, topics.action, tuple(ACTION_FIELDS), "action", topics)
    action_type = bag.topics[action].msgtype
    fields = topics.action_fields or ACTION_FIELDS[action_type]
    poses = _series(path, bag, odometry, tuple(ODOMETRY_FIELDS.values()))
    commands = _series(path, bag, action, tuple(fields))
    t, command_t, notes = _times(poses, commands)
    order = np.argsort(command_t, kind="stable")
    last = np.searchsorted(command_t[order], t, side="right") - 1
    known = last >= 0
    if not known.any():
        raise RecordingError(
            *(str(path), 0, action, "every command is stamped after the last odometry message"),
            "record both topics with the same clock",
        )
    held = order[np.maximum(last, 0)]
    age = (t - command_t[held])[known]
    if age.min() > OLD_COMMAND:
        raise RecordingError(
            *(str(path), 0, action, f"commands are at least {age.min():.1f} s old"),
            "record both topics with the same clock",
        )
    if not known.all():
        notes.append(f"first {(~known).sum()} rows, column {action!r}: no command yet: cut")
    if age.max() > OLD_COMMAND:
        notes.append(f"column {action!r}: commands are up to {age.max():.2f} s old")
    columns = dict(zip(ODOMETRY_FIELDS, poses["values"].T[:, known], strict=True))
    columns["t"] = t[known]
    columns["throttle"], columns["steering"] = commands["values"][held[known]].T
    labels = {name: f"{odometry}.{field}" for name, field in ODOMETRY_FIELDS.items()}
    labels |= {"t": odometry, "throttle": f"{action}.{fields[0]}"}
    labels |= {"steering": f"{action}.{fields[1]}"}
    return Table(str(path), columns, labels, notes, first_row=int(np.argmax(known)))


def _choose(path, bag, wanted, types, role, topics: Topics | None = None) -> str:
    """The topic of a role: the one asked for, or the only one of a fitting type."""
    listing = ", ".join(f"{name} ({info.msgtype})" for name, info in sorted(bag.topics.items()))
    if wanted is not None:
        if wanted not in bag.topics:
            reason = f"there is no topic {wanted}; there are: {listing}"
            raise RecordingError(str(path), None, wanted, reason, "correct the column map")
        fits = bag.topics[wanted].msgtype in types
        if not fits and not (topics and topics.action_fields):
            reason = f"it is a {bag.topics[wanted].msgtype}, not one of {', '.join(types)}"
            raise RecordingError(str(path), None, wanted, reason, "state topics.action_fields")
        return wanted
    found = [name for name, info in bag.topics.items() if info.msgtype in types]
    if len(found) != 1:
        reason = f"{len(found)} topics can be the {role}; there are: {listing}"
        remedy = f"name it under topics.{role} in a column map"
        raise RecordingError(str(path), None, role, reason, remedy)
    return found[0]


def _series(path: Path, bag: Any, topic: str, fields: tuple[str, ...]) -> dict[str, ndarray]:
    """Arrival and stamp [n] in s, and the values [n, fields] of a topic."""
    getters = [_getter(field) for field in fields]
    arrival, stamp, values = [], [], []
    connections = [c for c in bag.connections if c.topic == topic]
    for row, (connection, nanoseconds, raw) in enumerate(bag.messages(connections)):
        message = bag.deserialize(raw, connection.msgtype)
        arrival.append(nanoseconds)
        stamp.append(_stamp(message))
        try:
            values.append([float(get(message)) for get in getters])
        except (AttributeError, IndexError, TypeError) as error:
            reason = f"the message has no {', '.join(fields)} ({error})"
            raise RecordingError(
                str(path), row, topic, reason, "state topics.action_fields in a column map"
            ) from error
    if not values:
        raise RecordingError(str(path), None, topic, "the topic has no message", "record again")
    return {
        "arrival": np.array(arrival, np.int64) * 1e-9,
        "stamp": np.array(stamp, np.int64) * 1e-9,
        "values": np.array(values, np.float64),
    }


def _getter(field: str) -> Callable[[Any], Any]:
    """Access to `a.b[1].c` of a message."""
    steps = re.findall(r"[A-Za-z_]\w*|\[\d+\]", field)

    def get(message: Any) -> Any:
        for step in steps:
            message = message[int(step[1:-1])] if step.startswith("[") else getattr(message, step)
        return message

    return get


def _stamp(message: Any) -> int:
    """Header stamp in ns; 0 for a message without."""
    header = getattr(message, "header", None)
    return 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec


def _times(poses: dict, commands: dict) -> tuple[ndarray, ndarray, list[str]]:
    """Times of both topics on one clock: their stamps, or else when they arrived."""
    stamped = [bool((series["stamp"] > 0).all()) for series in (poses, commands)]
    distance = float(np.median(np.abs(poses["stamp"] - poses["arrival"])))
    if stamped[0] and (stamped[1] or distance < CLOCK_DISTANCE):
        return poses["stamp"], commands["stamp" if stamped[1] else "arrival"], []
    return poses["arrival"], commands["arrival"], ["column 't': time of arrival, not of stamp"]
