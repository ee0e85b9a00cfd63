"""The T265's axes, turned by hand; and a camera that calls back from another thread."""

import math
import threading
import time
from types import SimpleNamespace

import pytest

from buggy_rl.car.camera_t265 import T265, CameraMount, planar_motion

STRAIGHT = (0.0, 0.0, 0.0, 1.0)  # as it started
HALF = math.sqrt(0.5)
LEFT_TURNED = (0.0, HALF, 0.0, HALF)  # a quarter to the left: about y, which is up
STILL = (0.0, 0.0, 0.0)


def close(values):
    return pytest.approx(values, abs=1e-9)


def test_forward_is_minus_z_and_left_is_minus_x():
    # 2 m ahead and 1 m to the left of the start, still looking ahead; forward at 3, left at 0.5.
    pose, velocity = planar_motion((-1, 0, -2), STRAIGHT, (-0.5, 0, -3), STILL, CameraMount())
    assert pose == close((2, 1, 0))
    assert velocity == close((3, 0.5, 0))


def test_a_car_turned_to_the_left_drives_along_its_own_x():
    # Looking to the left, moving to the left at 2 m/s: that is forward. Turning left at 1 rad/s.
    pose, velocity = planar_motion(STILL, LEFT_TURNED, (-2, 0, 0), (0, 1, 0), CameraMount())
    assert pose == close((0, 0, math.pi / 2))
    assert velocity == close((2, 0, 1))


def test_a_pitched_camera_has_the_same_heading():
    pitch = math.radians(20)  # nose up: about x, to the right
    nose_up = (math.sin(pitch / 2), 0.0, 0.0, math.cos(pitch / 2))
    pose, velocity = planar_motion(STILL, nose_up, (0, 0, -1), STILL, CameraMount())
    assert pose == close(STILL)
    assert velocity == close((1, 0, 0))
    # Turned left by a quarter, then nose up: q = q_left q_up.
    s, c = nose_up[0], nose_up[3]
    pose, _ = planar_motion(
        STILL, (HALF * s, HALF * c, -HALF * s, HALF * c), STILL, STILL, CameraMount()
    )
    assert pose[2] == close(math.pi / 2)


def test_a_camera_ten_centimetres_ahead_sees_the_tail_swing():
    # The car turns about its reference point at 2 rad/s: the camera moves left at 0.2 m/s.
    mount = CameraMount(x=0.1)
    pose, velocity = planar_motion((-0.0, 0, -0.1), STRAIGHT, (-0.2, 0, 0), (0, 2, 0), mount)
    assert pose == close((0, 0, 0))
    assert velocity == close((0, 0, 2))
    # A quarter to the left the camera is 0.1 m to the left of the reference point.
    pose, velocity = planar_motion((-0.1, 0, 0), LEFT_TURNED, (0, 0, 0.2), (0, 2, 0), mount)
    assert pose == close((0, 0, math.pi / 2))
    assert velocity == close((0, 0, 2))


def test_a_camera_beside_the_middle_moves_slower_on_the_inside():
    # 5 cm to the left, turning left at 2 rad/s at 1 m/s: 0.1 m/s slower than the middle.
    pose, velocity = planar_motion(
        (-0.05, 0, 0), STRAIGHT, (0, 0, -0.9), (0, 2, 0), CameraMount(y=0.05)
    )
    assert pose == close((0, 0, 0))
    assert velocity == close((1, 0, 2))


def test_a_camera_that_looks_aside_is_turned_back():
    # Mounted a quarter to the left: the car's forward is the camera's right, +x.
    pose, velocity = planar_motion(STILL, STRAIGHT, (1, 0, 0), STILL, CameraMount(yaw=math.pi / 2))
    assert pose == close((0, 0, -math.pi / 2))
    assert velocity == close((1, 0, 0))


def test_a_lever_arm_changes_no_straight_drive():
    for mount in (CameraMount(), CameraMount(x=0.1, y=-0.03)):
        _, velocity = planar_motion(STILL, STRAIGHT, (0, 0, -2), STILL, mount)
        assert velocity == close((2, 0, 0))


class Frame:
    """A frame of the pose stream."""

    def __init__(self, x=0.0, confidence=3, stamp=5.0):
        self.stamp = stamp
        vector = SimpleNamespace(x=0.0, y=0.0, z=-x)
        self._data = SimpleNamespace(
            translation=vector,
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
            velocity=vector,
            angular_velocity=SimpleNamespace(x=0.0, y=0.0, z=0.0),
            tracker_confidence=confidence,
        )

    def as_pose_frame(self):
        return self

    def get_timestamp(self):
        return 1e3 * self.stamp  # [ms] of the camera's clock

    def get_pose_data(self):
        return self._data


class OtherFrame(Frame):
    """A frame of another stream: pyrealsense2 gives an empty pose frame."""

    def __bool__(self):
        return False


class Library:
    """pyrealsense2 with one camera, which calls back from a thread of its own."""

    stream = SimpleNamespace(pose="pose")

    def __init__(self, frames, fault=""):
        self._frames, self._fault, self.streams, self.stopped = frames, fault, [], 0

    def config(self):
        return SimpleNamespace(enable_stream=self.streams.append)

    def pipeline(self):
        return self

    def start(self, config, heard):
        if self._fault:
            raise RuntimeError(self._fault)
        self.thread = threading.Thread(target=lambda: [heard(frame) for frame in self._frames])
        self.thread.start()

    def stop(self):
        self.stopped += 1


def test_frames_become_readings_in_their_order_as_far_apart_as_they_were_measured():
    before = time.monotonic()
    library = Library([Frame(0.1, 1, stamp=5.0), OtherFrame(), Frame(0.2, 3, stamp=5.005)])
    camera = T265(library=library)
    library.thread.join()
    first, second = camera.readings()
    assert camera.readings() == []
    assert before - 0.005 <= first.stamp <= second.stamp <= time.monotonic()
    assert (first.pose[0], second.pose[0]) == (0.1, 0.2)
    assert (first.confidence, second.confidence) == (pytest.approx(1 / 3), 1.0)
    assert camera.latest() is second
    assert library.streams == ["pose"]


def test_before_the_first_frame_there_is_no_reading():
    camera = T265(library=Library([]))
    assert camera.latest() is None
    assert camera.readings() == []


def test_closed_twice_the_stream_is_stopped_once():
    library = Library([])
    camera = T265(library=library)
    camera.close()
    camera.close()
    assert library.stopped == 1


def test_a_missing_camera_and_a_missing_library_say_what_to_do(monkeypatch):
    with pytest.raises(OSError, match="No device connected: plug it into a USB 3 port"):
        T265(library=Library([], "No device connected"))
    monkeypatch.setitem(__import__("sys").modules, "pyrealsense2", None)
    with pytest.raises(ImportError, match="needs pyrealsense2"):
        T265.from_dict({"x": 0.1})


def test_a_mount_out_of_range_is_named():
    with pytest.raises(ValueError, match=r"sensor\.x=100\.0: must be in \[-1, 1\]"):
        T265.from_dict({"x": 100.0})
