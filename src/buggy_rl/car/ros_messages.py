"""ROS 2 messages to readings and commands to messages, as functions of their arguments alone."""

import math
from typing import Any, Mapping, NamedTuple, Tuple

from buggy_rl.car.interfaces import Reading


class Odometry(NamedTuple):
    """What is listened to."""

    topic: str = "/odom"
    largest_variance: float = 0.1
    """Of x or y in the message's covariance [m^2]; above it the tracker counts as lost."""


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
    """At full throttle [m/s]."""
    top_acceleration: float = 5.0
    """At full throttle [m/s^2], where it asks for acceleration."""
    two_way: bool = False
    """For a car that reverses: 0 is no drive, -1 full speed back, or a full brake where the
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
