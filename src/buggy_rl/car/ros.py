"""The same runtime on a car that speaks ROS 2: odometry in, Ackermann commands out.

In the config, `python -m buggy_rl.car CONFIG.json`:

    "sensor": {"kind": "buggy_rl.car.ros:OdometrySensor", "topic": "/odom"},
    "actuator": {"kind": "buggy_rl.car.ros:AckermannActuator", "topic": "/drive"}

The loop holds the node that listens and the watchdog's process the one that publishes, so that
neutral goes out when the loop is gone. rclpy is imported when a node is made (Humble or later).
"""

import math
import os
import threading
import time
from typing import Any, List, Mapping, NamedTuple, Optional, Tuple

from buggy_rl.car.board_lock import lock_file
from buggy_rl.car.clock import DeviceClock
from buggy_rl.car.interfaces import Actuator, Reading, Sensor, neutral_of
from buggy_rl.car.settings import section


class Odometry(NamedTuple):
    """What is listened to."""

    topic: str = "/odom"
    largest_variance: float = 0.1
    """Variance of x or y in the message's covariance [m^2] above which the tracker counts as
    lost."""


class Ackermann(NamedTuple):
    """What a command means on this car."""

    topic: str = "/drive"
    frame: str = "base_link"
    """`frame_id` of the messages."""
    lock_left: float = 0.32
    """Road-wheel angle at steering 1 [rad]."""
    lock_right: float = 0.40
    """Road-wheel angle at steering -1, as a positive number [rad]."""
    throttle: str = "acceleration"
    """What the throttle asks for: acceleration or speed."""
    top_speed: float = 3.5
    """Speed at full throttle [m/s]."""
    top_acceleration: float = 5.0
    """Acceleration at full throttle [m/s^2], where it asks for acceleration."""
    two_way: bool = False
    """Whether the car reverses: 0 is no drive, -1 full speed back, or a full brake where the
    throttle asks for acceleration; set by `car.two_way`."""


ODOMETRY_RANGES = {"largest_variance": (0.0, 1e3)}
ACKERMANN_RANGES: Mapping[str, Any] = {
    "lock_left": (0.05, 1.0),
    "lock_right": (0.05, 1.0),
    "throttle": ("acceleration", "speed"),
    "top_speed": (0.1, 15.0),
    "top_acceleration": (0.1, 20.0),
}


def seconds(stamp: Any) -> float:
    """[s] of a `builtin_interfaces/Time`."""
    return stamp.sec + 1e-9 * stamp.nanosec


def yaw_of(quaternion: Any) -> float:
    """Heading [rad] of a `geometry_msgs/Quaternion`: atan2(2 (wz + xy), 1 - 2 (y^2 + z^2))."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def to_reading(message: Any, stamp: float, largest_variance: float) -> Reading:
    """A reading of a `nav_msgs/Odometry`, whose twist is in the child frame: the car's body.

    Args:
        message: Pose in `header.frame_id`, twist in `child_frame_id`.
        stamp: When it was measured, on this computer's monotonic clock [s]; the message's own stamp
            is of a clock that may step.
        largest_variance: Of x or y [m^2] for confidence 1; above it 0.
    """
    pose, twist = message.pose.pose, message.twist.twist
    variance = max(message.pose.covariance[0], message.pose.covariance[7])
    return Reading(
        stamp,
        (pose.position.x, pose.position.y, yaw_of(pose.orientation)),
        (twist.linear.x, twist.linear.y, twist.angular.z),
        1.0 if variance <= largest_variance else 0.0,  # NaN too is no confidence
    )


def ackermann_of(throttle: float, steering: float, car: Ackermann) -> Tuple[float, float, float]:
    """Steering angle [rad] to the left, speed [m/s], acceleration [m/s^2] of a command.

    No drive asks for speed 0; acceleration 0 means as fast as the car can, by the message's
    definition.
    """
    lock = car.lock_left if steering > 0 else car.lock_right
    drive = throttle if car.two_way else 0.5 * (throttle + 1)
    if car.throttle == "speed":
        return lock * steering, drive * car.top_speed, 0.0
    speed = car.top_speed if drive > 0 else 0.0
    return lock * steering, speed, abs(drive) * car.top_acceleration


def fill_drive(message: Any, throttle: float, steering: float, car: Ackermann) -> None:
    """Writes a command into an `ackermann_msgs/AckermannDriveStamped`."""
    angle, speed, acceleration = ackermann_of(throttle, steering, car)
    message.header.frame_id = car.frame
    message.drive.steering_angle = angle
    message.drive.speed = speed
    message.drive.acceleration = acceleration


DEPTH = 1  # of the queues: an old message is worth nothing
KEPT = 400  # readings that wait to be recorded


class OdometrySensor(Sensor):
    """Listens to odometry in a thread of its own.

    Args:
        about: What to listen to.

    Raises:
        ImportError: ROS 2 is not sourced.
    """

    def __init__(self, about: Optional[Odometry] = None) -> None:
        self._about = about or Odometry()
        self._lock, self._clock = threading.Lock(), DeviceClock()
        self._last: Optional[Reading] = None
        self._waiting: List[Reading] = []
        self._stamp = -math.inf
        rclpy = _started()
        message = _message("nav_msgs", "Odometry")
        self._node = rclpy.create_node("buggy_rl_sensor")
        self._node.create_subscription(message, self._about.topic, self._heard, DEPTH)
        self._thread = threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True)
        self._thread.start()

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "OdometrySensor":
        """Makes a sensor from settings: the fields of `Odometry`."""
        return cls(section(Odometry, settings, "sensor", ODOMETRY_RANGES))

    def latest(self) -> Optional[Reading]:
        with self._lock:
            return self._last

    def readings(self) -> List[Reading]:
        with self._lock:
            waiting, self._waiting = self._waiting, []
        return waiting

    def close(self) -> None:
        _stopped(self._node)

    def _heard(self, message: Any) -> None:
        """A message; one that is not newer than the last is left out."""
        now, stamp = time.monotonic(), seconds(message.header.stamp)
        if stamp <= self._stamp:
            return
        self._stamp = stamp
        measured = self._clock.time(stamp, now)
        reading = to_reading(message, measured, self._about.largest_variance)
        with self._lock:
            self._last = reading
            self._waiting = [*self._waiting[-KEPT:], reading]


class AckermannActuator(Actuator):
    """Publishes commands.

    Args:
        car: What a command means.
        node: Name of its node.

    Raises:
        ImportError: ROS 2 is not sourced, or ackermann_msgs is not installed.
    """

    def __init__(self, car: Optional[Ackermann] = None, node: str = "buggy_rl_actuator") -> None:
        self._car = car or Ackermann()
        self.at_rest = neutral_of(self._car.two_way)
        rclpy = _started()
        self._message = _message("ackermann_msgs", "AckermannDriveStamped")
        self._node = rclpy.create_node(node)
        self._publisher = self._node.create_publisher(self._message, self._car.topic, DEPTH)
        self._listeners = getattr(self._publisher, "get_subscription_count", None)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "AckermannActuator":
        """Makes an actuator from settings: the fields of `Ackermann`."""
        return cls(section(Ackermann, settings, "actuator", ACKERMANN_RANGES))

    @classmethod
    def board(cls, settings: Mapping[str, Any]) -> str:
        topic = section(Ackermann, settings, "actuator", ACKERMANN_RANGES).topic
        return lock_file("ros {} {}".format(os.environ.get("ROS_DOMAIN_ID", "0"), topic))

    @classmethod
    def second(cls, settings: Mapping[str, Any]) -> "AckermannActuator":
        return cls(section(Ackermann, settings, "actuator", ACKERMANN_RANGES), "buggy_rl_stop")

    def write(self, throttle: float, steering: float) -> None:
        message = self._message()
        message.header.stamp = self._node.get_clock().now().to_msg()
        fill_drive(message, throttle, steering, self._car)
        try:
            self._publisher.publish(message)
        except RuntimeError as error:  # rclpy's, of a context that is shut down
            raise OSError(f"ROS topic {self._car.topic}: {error}") from None
        if self._listeners is not None and not self._listeners():
            raise OSError(f"ROS topic {self._car.topic}: nobody listens to it")

    def close(self) -> None:
        _stopped(self._node)


def _started() -> Any:
    """rclpy, initialised without its signal handlers: the runtime has its own."""
    try:
        import rclpy  # pyright: ignore[reportMissingImports]
        from rclpy.signals import SignalHandlerOptions  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(
            "buggy_rl.car.ros needs ROS 2 (Humble or later) in this Python: source "
            "/opt/ros/DISTRO/setup.bash first"
        ) from None
    if not rclpy.ok():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    return rclpy


def _stopped(node: Any) -> None:
    """Ends a node, and ROS in this process; a second call does nothing."""
    import rclpy  # pyright: ignore[reportMissingImports]

    if rclpy.ok():
        node.destroy_node()
        rclpy.shutdown()


def _message(package: str, name: str) -> Any:
    """The class of a message."""
    import importlib

    try:
        return getattr(importlib.import_module(package + ".msg"), name)
    except ImportError:
        named = package.replace("_", "-")
        raise ImportError(f"needs {package}: apt install ros-DISTRO-{named}") from None
