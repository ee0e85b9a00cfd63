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
"""Message type -> fields of throttle and steering, unless the column map names others."""

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
"""Channel -> field; the twist of an odometry message is defined in the body frame."""

CLOCK_DISTANCE = 0.5  # [s] between stamp and arrival of one clock; a slow network is faster
OLD_COMMAND = 0.5  # [s] age of a command that is noted; a joystick may be silent for longer


def is_bag(path: Path) -> bool:
    """Whether this is a ROS 1 bag file or the folder of a ROS 2 bag."""
    if path.is_dir():
        return any(path.glob("*.db3*")) or any(path.glob("*.mcap*"))
    return path.suffix == ".bag"


def read_bag(path: Path, topics: Topics) -> Table:
    """Reads the odometry messages, each with the last command at or before its stamp.

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
        message = f"the bag cannot be read ({error!r}); repair it with the ROS bag tools"
        raise RecordingError(str(path), message) from error


def _table(path: Path, bag: Any, topics: Topics) -> Table:
    odometry = _choose(path, bag, topics, "odometry", (ODOMETRY,))
    action = _choose(path, bag, topics, "action", tuple(ACTION_FIELDS))
    action_type = bag.topics[action].msgtype
    fields = topics.action_fields or ACTION_FIELDS[action_type]
    poses = _series(path, bag, odometry, tuple(ODOMETRY_FIELDS.values()))
    commands = _series(path, bag, action, tuple(fields))
    t, command_t, notes = _times(poses, commands)
    order = np.argsort(command_t, kind="stable")
    last = np.searchsorted(command_t[order], t, side="right") - 1
    known = last >= 0
    if not known.any():
        message = "all commands are stamped after the last odometry message; use one clock for both"
        raise RecordingError(str(path), message, 0, action)
    held = order[np.maximum(last, 0)]
    age = (t - command_t[held])[known]
    if age.min() > OLD_COMMAND:
        message = f"all commands are at least {age.min():.1f} s old; use one clock for both topics"
        raise RecordingError(str(path), message, 0, action)
    if not known.all():
        notes.append(f"first {(~known).sum()} rows, column {action}: no command yet: cut")
    if age.max() > OLD_COMMAND:
        notes.append(f"column {action}: commands are up to {age.max():.2f} s old")
    columns = dict(zip(ODOMETRY_FIELDS, poses["values"].T[:, known], strict=True))
    columns["t"] = t[known]
    columns["throttle"], columns["steering"] = commands["values"][held[known]].T
    labels = {name: f"{odometry}.{field}" for name, field in ODOMETRY_FIELDS.items()}
    labels |= {"t": odometry, "throttle": f"{action}.{fields[0]}"}
    labels |= {"steering": f"{action}.{fields[1]}"}
    return Table(str(path), columns, labels, notes, first_row=int(np.argmax(known)))


def _choose(path: Path, bag: Any, topics: Topics, role: str, types: tuple[str, ...]) -> str:
    """The topic of a role: the one named in the column map, or the only one of a suitable type."""
    listing = ", ".join(f"{name} ({info.msgtype})" for name, info in sorted(bag.topics.items()))
    wanted = getattr(topics, role)
    if wanted is None:
        found = [name for name, info in bag.topics.items() if info.msgtype in types]
        if len(found) == 1:
            return found[0]
        message = f"{len(found)} topics can be the {role}; name it under topics.{role}; available: "
        raise RecordingError(str(path), message + listing, column=role)
    if wanted not in bag.topics:
        message = f"no topic {wanted}; correct the column map; available: {listing}"
        raise RecordingError(str(path), message, column=wanted)
    kind = bag.topics[wanted].msgtype
    if kind not in types and not (role == "action" and topics.action_fields):
        message = f"type {kind} is not one of {', '.join(types)}; state topics.action_fields"
        raise RecordingError(str(path), message, column=wanted)
    return wanted


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
            message = (
                f"the message has no {', '.join(fields)} ({error}); state topics.action_fields"
            )
            raise RecordingError(str(path), message, row, topic) from error
    if not values:
        raise RecordingError(str(path), "the topic has no message; record again", column=topic)
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
    """Times of both topics on one clock: the stamps, otherwise the times of arrival."""
    stamped = [bool((series["stamp"] > 0).all()) for series in (poses, commands)]
    distance = float(np.median(np.abs(poses["stamp"] - poses["arrival"])))
    if stamped[0] and (stamped[1] or distance < CLOCK_DISTANCE):
        return poses["stamp"], commands["stamp" if stamped[1] else "arrival"], []
    return poses["arrival"], commands["arrival"], ["column t: time of arrival, not of stamp"]
