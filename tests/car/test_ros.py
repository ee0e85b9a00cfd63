"""ROS 2: message conversions on real message types, and both nodes on a stand-in for rclpy."""

import math
import sys
import threading
import time
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from buggy_rl.car.ros import (
    Ackermann,
    AckermannActuator,
    OdometrySensor,
    ackermann_of,
    fill_drive,
    seconds,
    to_reading,
    yaw_of,
)

STORE = get_typestore(Stores.ROS2_HUMBLE)
DRIVE = (
    "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
    "float32 acceleration\nfloat32 jerk\n"
)
STORE.register(get_types_from_msg(DRIVE, "ackermann_msgs/msg/AckermannDrive"))
STAMPED = "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
STORE.register(get_types_from_msg(STAMPED, "ackermann_msgs/msg/AckermannDriveStamped"))
T = STORE.types
HALF = math.sqrt(0.5)


def header(sec=12, nanosec=250_000_000):
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](sec, nanosec), "odom")


def vector(x=0.0, y=0.0, z=0.0):
    return T["geometry_msgs/msg/Vector3"](x, y, z)


def odometry(x=1.0, y=-2.0, q=(0.0, 0.0, 0.0, 1.0), variance=1e-3, **at):
    covariance = np.zeros(36)
    covariance[0] = covariance[7] = variance
    pose = T["geometry_msgs/msg/Pose"](
        T["geometry_msgs/msg/Point"](x, y, 0.1), T["geometry_msgs/msg/Quaternion"](*q)
    )
    twist = T["geometry_msgs/msg/Twist"](vector(3.0, 0.5), vector(z=0.7))
    message = T["nav_msgs/msg/Odometry"](
        header(**at),
        "base_link",
        T["geometry_msgs/msg/PoseWithCovariance"](pose, covariance),
        T["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )
    # Through the wire format, so that every field has the type that ROS gives it.
    kind = "nav_msgs/msg/Odometry"
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, kind), kind)


def drive_message():
    drive = T["ackermann_msgs/msg/AckermannDrive"](0.0, 0.0, 0.0, 0.0, 0.0)
    return T["ackermann_msgs/msg/AckermannDriveStamped"](header(), drive)


def sent(message):
    """The message as a subscriber gets it."""
    kind = "ackermann_msgs/msg/AckermannDriveStamped"
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, kind), kind)


def test_a_stamp_is_seconds():
    assert seconds(header().stamp) == 12.25


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, math.pi / 2])
def test_a_level_quaternion_is_its_heading_even_pitched(yaw):
    q = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    assert yaw_of(q) == pytest.approx(yaw)
    s, c = math.sin(0.15), math.cos(0.15)  # then nose down by 0.3 rad: q_yaw q_pitch
    pitched = T["geometry_msgs/msg/Quaternion"](-q.z * s, q.w * s, q.z * c, q.w * c)
    assert yaw_of(pitched) == pytest.approx(yaw)


def test_the_twist_is_taken_as_it_is_in_the_body_frame():
    # Heading to the left: a velocity of 3 m/s forward stays forward, whatever the heading.
    reading = to_reading(odometry(q=(0.0, 0.0, HALF, HALF)), 7.0, 0.1)
    assert reading.stamp == 7.0
    assert reading.pose == pytest.approx((1.0, -2.0, math.pi / 2))
    assert reading.velocity == (3.0, 0.5, 0.7)
    assert reading.confidence == 1.0


@pytest.mark.parametrize("variance", [0.2, math.nan, math.inf])
def test_an_uncertain_pose_has_no_confidence(variance):
    assert to_reading(odometry(variance=variance), 0.0, 0.1).confidence == 0.0


@pytest.mark.parametrize(
    ("throttle", "steering", "kind", "expected"),
    [
        (-1.0, 0.0, "acceleration", (0.0, 0.0, 0.0)),  # no drive: speed 0
        (0.0, 1.0, "acceleration", (0.3, 4.0, 1.0)),  # half of 2 m/s^2, full left
        (1.0, -0.5, "acceleration", (-0.2, 4.0, 2.0)),  # half of 0.4 rad to the right
        (-1.0, 0.0, "speed", (0.0, 0.0, 0.0)),
        (0.5, 1.0, "speed", (0.3, 3.0, 0.0)),  # three quarters of 4 m/s
    ],
)
def test_a_command_is_an_angle_and_a_speed_or_an_acceleration(throttle, steering, kind, expected):
    numbers = {"lock_left": 0.3, "lock_right": 0.4, "top_speed": 4.0, "top_acceleration": 2.0}
    car = Ackermann(throttle=kind, **numbers)
    assert ackermann_of(throttle, steering, car) == pytest.approx(expected)
    message = drive_message()
    fill_drive(message, throttle, steering, car)
    drive = sent(message).drive
    assert (drive.steering_angle, drive.speed, drive.acceleration) == pytest.approx(expected)
    assert (drive.steering_angle_velocity, drive.jerk) == (0.0, 0.0)
    assert sent(message).header.frame_id == "base_link"


class Ros(ModuleType):
    """rclpy with topics inside of this process."""

    def __init__(self):
        super().__init__("rclpy")
        self.running, self.heard, self.published = False, {}, []
        self.ended = threading.Event()

    def init(self, signal_handler_options):
        self.running, self.signals = True, signal_handler_options
        self.ended.clear()

    def ok(self):
        return self.running

    def shutdown(self):
        self.running = False
        self.ended.set()

    def spin(self, node):
        self.ended.wait(10)

    def create_node(self, name):
        return SimpleNamespace(
            create_subscription=lambda kind, topic, call, depth: self.heard.update({topic: call}),
            create_publisher=lambda kind, topic, depth: SimpleNamespace(publish=self._publish),
            get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(to_msg=self._stamp)),
            destroy_node=lambda: None,
        )

    def _stamp(self):
        return T["builtin_interfaces/msg/Time"](99, 0)

    def _publish(self, message):
        if not self.running:
            raise RuntimeError("context is invalid")
        self.published.append(sent(message))


@pytest.fixture
def ros(monkeypatch):
    made = Ros()
    modules = {
        "rclpy": made,
        "rclpy.signals": SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="none")),
        "nav_msgs.msg": SimpleNamespace(Odometry=T["nav_msgs/msg/Odometry"]),
        "ackermann_msgs.msg": SimpleNamespace(AckermannDriveStamped=drive_message),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return made


def test_odometry_becomes_readings_on_the_monotonic_clock(ros):
    sensor = OdometrySensor.from_dict({"topic": "/tracker/odom"})
    assert sensor.latest() is None
    before = time.monotonic()
    for index in range(3):
        ros.heard["/tracker/odom"](odometry(x=0.1 * index, nanosec=10_000_000 * index))
    readings = sensor.readings()
    assert [reading.pose[0] for reading in readings] == [0.0, 0.1, 0.2]
    assert before - 0.02 <= readings[0].stamp <= readings[-1].stamp <= time.monotonic()
    assert sensor.latest() == readings[-1]
    assert sensor.readings() == []
    sensor.close()
    sensor.close()
    assert ros.ended.is_set()


def test_a_message_that_comes_late_or_twice_is_left_out(ros):
    sensor = OdometrySensor()
    for sec in (5, 6, 6, 4):
        ros.heard["/odom"](odometry(sec=sec))
    assert len(sensor.readings()) == 2
    sensor.close()


def test_commands_are_published_and_neutral_is_no_speed_and_straight_wheels(ros):
    actuator = AckermannActuator.from_dict({"throttle": "speed", "top_speed": 2.0})
    actuator.write(1.0, -1.0)
    actuator.neutral()
    full, neutral = (message.drive for message in ros.published)
    assert (full.speed, full.steering_angle) == pytest.approx((2.0, -0.4))
    assert (neutral.speed, neutral.steering_angle, neutral.acceleration) == (0.0, 0.0, 0.0)
    assert ros.published[0].header.stamp.sec == 99
    assert ros.signals == "none"
    actuator.close()
    with pytest.raises(OSError, match=r"/drive: context is invalid"):
        actuator.write(0.0, 0.0)


def test_a_command_that_nobody_listens_to_is_an_error(ros):
    actuator = AckermannActuator.from_dict({})
    actuator._listeners = lambda: 0
    with pytest.raises(OSError, match="/drive: nobody listens to it"):
        actuator.write(-1.0, 0.0)
    actuator._listeners = lambda: 1
    actuator.write(-1.0, 0.0)


def test_a_second_handle_has_a_node_of_its_own_and_the_same_board(ros, monkeypatch):
    names, make = [], ros.create_node
    monkeypatch.setattr(ros, "create_node", lambda name: names.append(name) or make(name))
    AckermannActuator.from_dict({})
    AckermannActuator.second({})
    assert names == ["buggy_rl_actuator", "buggy_rl_stop"]
    assert AckermannActuator.board({}) == AckermannActuator.board({"top_speed": 1.0})
    assert AckermannActuator.board({}) != AckermannActuator.board({"topic": "/other"})


def test_without_ros_the_error_says_what_to_source(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(ImportError, match=r"needs ROS 2 .Humble or later. .*setup\.bash"):
        OdometrySensor()


def test_without_its_messages_the_error_names_the_package(ros, monkeypatch):
    monkeypatch.setitem(sys.modules, "ackermann_msgs.msg", None)
    with pytest.raises(ImportError, match="apt install ros-DISTRO-ackermann-msgs"):
        AckermannActuator()


def test_a_wrong_setting_is_named():
    with pytest.raises(ValueError, match=r"actuator\.throttle='torque': must be one of accel"):
        AckermannActuator.from_dict({"throttle": "torque"})
