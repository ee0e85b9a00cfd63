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
from typing import Any, List, Mapping, Optional

from buggy_rl.car.board_lock import lock_file
from buggy_rl.car.device_clock import DeviceClock
from buggy_rl.car.interfaces import Actuator, Reading, Sensor, neutral_of
from buggy_rl.car.ros_messages import (
    ACKERMANN_RANGES,
    ODOMETRY_RANGES,
    Ackermann,
    Odometry,
    fill_drive,
    seconds,
    to_reading,
)
from buggy_rl.car.settings import section

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
        """Of its settings, those of `Odometry`."""
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
        """Of its settings, those of `Ackermann`."""
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
