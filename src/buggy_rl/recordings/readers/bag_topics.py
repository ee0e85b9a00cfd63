"""Message types of bags: which hold poses and commands, and the definitions that bags may lack."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from buggy_rl.recordings.columns import Topics
from buggy_rl.recordings.recording import RecordingError

ODOMETRY = "nav_msgs/msg/Odometry"


def _pose_fields(position: str, orientation: str) -> dict[str, str]:
    fields = {"x": f"{position}.x", "y": f"{position}.y"}
    return fields | {f"q{axis}": f"{orientation}.{axis}" for axis in "wxyz"}


_WITH_COVARIANCE = _pose_fields("pose.pose.position", "pose.pose.orientation")
POSE_FIELDS: dict[str, dict[str, str]] = {
    ODOMETRY: {
        **_WITH_COVARIANCE,
        "vx": "twist.twist.linear.x",
        "vy": "twist.twist.linear.y",
        "yaw_rate": "twist.twist.angular.z",
    },
    "geometry_msgs/msg/PoseStamped": _pose_fields("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _WITH_COVARIANCE,
    "geometry_msgs/msg/TransformStamped": _pose_fields(
        "transform.translation", "transform.rotation"
    ),
}
"""Message type -> channel -> field; the twist of an odometry message is in the body frame."""

ACTION_FIELDS = {
    "geometry_msgs/msg/Vector3": ("x", "y"),
    "geometry_msgs/msg/Vector3Stamped": ("vector.x", "vector.y"),
    "geometry_msgs/msg/Twist": ("linear.x", "angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.angular.z"),
    "std_msgs/msg/Float32MultiArray": ("data[0]", "data[1]"),
    "std_msgs/msg/Float64MultiArray": ("data[0]", "data[1]"),
    "sensor_msgs/msg/Joy": ("axes[0]", "axes[1]"),
    "ackermann_msgs/msg/AckermannDrive": ("speed", "steering_angle"),
    "ackermann_msgs/msg/AckermannDriveStamped": ("drive.speed", "drive.steering_angle"),
}
"""Message type -> fields of throttle and steering, unless the column map names others."""
ACKERMANN = "ackermann_msgs/msg/AckermannDrive"
WHEEL_SPEED = {"vesc_msgs/msg/VescStateStamped": "state.speed", "vesc_msgs/msg/VescState": "speed"}
"""Message type -> field of the motor's speed [rpm, electrical], a wheel speed in its own unit."""

_HEADER = "std_msgs/Header header\n"
_ACKERMANN_FIELDS = "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"
_VESC_FIELDS = (
    *("float64 " + name for name in ("temp_fet", "temp_motor", "current_motor", "current_input")),
    *("float64 " + name for name in ("avg_id", "avg_iq", "duty_cycle", "speed", "voltage_input")),
    *("float64 " + name for name in ("charge_drawn", "charge_regen")),
    *("float64 " + name for name in ("energy_drawn", "energy_regen")),
    *("int32 " + name for name in ("displacement", "distance_traveled", "fault_code")),
    *("float64 pid_pos_now", "int32 controller_id"),
    *("float64 " + name for name in ("ntc_temp_mos1", "ntc_temp_mos2", "ntc_temp_mos3")),
    *("float64 avg_vd", "float64 avg_vq"),
)
DEFINITIONS = {
    ACKERMANN: "\n".join(f"float32 {name}" for name in _ACKERMANN_FIELDS),
    ACKERMANN + "Stamped": _HEADER + "ackermann_msgs/AckermannDrive drive\n",
    "vesc_msgs/msg/VescState": "\n".join(_VESC_FIELDS),
    "vesc_msgs/msg/VescStateStamped": _HEADER + "vesc_msgs/VescState state\n",
}
"""Types outside of ROS's own that .db3 bags up to ROS 2 Humble hold without a definition.

Of `VescState` the layout of the driver for ROS 2 (github.com/f1tenth/vesc, 6e71bd7).
"""


def known_types() -> Any:
    """A typestore of ROS 2 Humble's types and `DEFINITIONS`."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def pose_topic(path: Path, bag: Any, topics: Topics) -> tuple[str, list[str]]:
    """The topic of the pose, and notes: the one that is named, or the only one that can be it.

    Without a name an odometry topic comes first; that there are others is noted.
    """
    listing, wanted = _listing(bag), topics.odometry
    if wanted is not None:
        kind = _named(path, bag, wanted)
        if kind not in POSE_FIELDS:
            message = f"type {kind} holds no pose; name a topic of {', '.join(POSE_FIELDS)} "
            message += f"under topics.odometry; available: {listing}"
            raise RecordingError(str(path), message, column=wanted)
        return wanted, []
    found = _of_types(bag, tuple(POSE_FIELDS))
    first = [name for name in found if bag.topics[name].msgtype == ODOMETRY] or found
    if len(first) != 1:
        what = (
            "name it under topics.odometry" if first else "record one of " + ", ".join(POSE_FIELDS)
        )
        message = f"{len(first)} topics can be the odometry; {what}; available: {listing}"
        raise RecordingError(str(path), message, column="odometry")
    others = [name for name in found if name != first[0]]
    if not others:
        return first[0], []
    note = f"column {first[0]}: read as the pose; {', '.join(others)} can be it too: if so, "
    return first[0], [note + "name it under topics.odometry"]


def command_fields(path: Path, bag: Any, topics: Topics) -> list[tuple[str, str]]:
    """Topic and field of throttle and steering.

    A field that is written `/topic:field` has a topic of its own.
    """
    own = [field.rpartition(":") for field in topics.action_fields]
    if own and all(topic for topic, _, _ in own):
        for topic, _, _ in own:
            _named(path, bag, topic)
        return [(topic, field) for topic, _, field in own]
    action = _action_topic(path, bag, topics)
    if not own:
        return [(action, field) for field in ACTION_FIELDS[bag.topics[action].msgtype]]
    for topic in (topic for topic, _, _ in own if topic):
        _named(path, bag, topic)
    return [(topic or action, field) for topic, _, field in own]


def _action_topic(path: Path, bag: Any, topics: Topics) -> str:
    listing, wanted = _listing(bag), topics.action
    if wanted is None:
        found = _of_types(bag, tuple(ACTION_FIELDS))
        if len(found) == 1:
            return found[0]
        name = "name it under topics.action"
        if not found:
            name = (
                "name the topic under topics.action and its two fields under topics.action_fields, "
                'or both as action_fields: ["/topic:field", "/topic:field"]'
            )
        message = f"{len(found)} topics can be the action; {name}; available: {listing}"
        raise RecordingError(str(path), message, column="action")
    kind = _named(path, bag, wanted)
    if kind not in ACTION_FIELDS and not topics.action_fields:
        numbers = ", ".join(numeric_fields(bag.typestore, kind)) or "none"
        message = (
            f"type {kind} is not one of {', '.join(ACTION_FIELDS)}; name throttle and steering, "
            f"two of its numbers, under topics.action_fields; it has {numbers}"
        )
        raise RecordingError(str(path), message, column=wanted)
    return wanted


def _named(path: Path, bag: Any, topic: str) -> str:
    """Type of a topic that a column map names."""
    if topic not in bag.topics:
        message = f"no topic {topic}; correct the column map; available: {_listing(bag)}"
        raise RecordingError(str(path), message, column=topic)
    return str(bag.topics[topic].msgtype)


def _listing(bag: Any) -> str:
    return ", ".join(f"{name} ({info.msgtype})" for name, info in sorted(bag.topics.items()))


def _of_types(bag: Any, types: tuple[str, ...]) -> list[str]:
    """Topics of some types, those that are empty only where no other is."""
    found = [name for name, info in bag.topics.items() if info.msgtype in types]
    return [name for name in found if bag.topics[name].msgcount] or found


def wheel_topic(bag: Any) -> str | None:
    """The only topic of a wheel speed."""
    found = [name for name in _of_types(bag, tuple(WHEEL_SPEED)) if bag.topics[name].msgcount]
    return found[0] if len(found) == 1 else None


def numeric_fields(store: Any, kind: str, prefix: str = "", most: int = 40) -> list[str]:
    """Numbers of a message type, as the column map names them; none of an unknown type."""
    return [field for _, field in zip(range(most), _numbers(store, kind, prefix), strict=False)]


def _numbers(store: Any, kind: str, prefix: str) -> Iterator[str]:
    from rosbags.interfaces import Nodetype

    if kind not in store.fielddefs:
        return
    for name, (node, detail) in store.fielddefs[kind][1]:
        if name == "header":
            continue
        if node == Nodetype.BASE and re.fullmatch(r"u?int\d+|float\d+", detail[0]):
            yield prefix + name
        elif node == Nodetype.NAME:
            yield from _numbers(store, detail, f"{prefix}{name}.")
        elif node in (Nodetype.ARRAY, Nodetype.SEQUENCE) and detail[0][0] == Nodetype.BASE:
            yield f"{prefix}{name}[0]"
