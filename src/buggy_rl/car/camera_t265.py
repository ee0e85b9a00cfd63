"""The tracking camera T265: its pose stream as planar motion of the car's reference point.

The camera's world has x to the right, y up and z backwards of where it pointed when it started; its
body likewise. Velocity and angular velocity come in that world. Here x is forward, y left, z up.
"""

import math
import threading
import time
from collections import deque
from typing import Any, Deque, List, Mapping, NamedTuple, Optional, Tuple

from buggy_rl.car.clock import DeviceClock
from buggy_rl.car.interfaces import Reading, Sensor
from buggy_rl.car.settings import section

Triple = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
"""x, y, z, w."""

FULL_CONFIDENCE = 3  # of the tracker: 0 failed, 1 low, 2 medium, 3 high
KEPT = 400  # readings that wait to be recorded: 2 s at the camera's 200 Hz


class CameraMount(NamedTuple):
    """Place and direction of the camera on the car."""

    x: float = 0.0
    """Camera ahead of the reference point [m]."""
    y: float = 0.0
    """Camera to the left of the reference point [m]."""
    yaw: float = 0.0
    """The camera points to the left of the car's x axis by this angle [rad]."""


RANGES = {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "yaw": (-math.pi, math.pi)}


def planar_motion(
    translation: Triple,
    rotation: Quaternion,
    velocity: Triple,
    angular_velocity: Triple,
    mount: CameraMount,
) -> Tuple[Triple, Triple]:
    """Pose and velocity of the reference point from those of the camera.

    v_ref = R(-yaw) v_camera - yaw_rate x arm,  p_ref = p_camera - R(yaw) arm.

    Args:
        translation: [m] in the camera's world.
        rotation: Of the camera's body in that world.
        velocity: [m/s] in that world.
        angular_velocity: [rad/s] in that world.
        mount: Of the camera on the car.

    Returns:
        x, y [m], yaw [rad] in [-pi, pi]; vx, vy [m/s], yaw_rate [rad/s] in the body frame.
    """
    qx, qy, qz, qw = rotation
    # The camera looks along -z of its body: the floor's components of where that points.
    ahead, left = 1 - 2 * (qx * qx + qy * qy), 2 * (qx * qz + qw * qy)
    heading = math.atan2(left, ahead) - mount.yaw
    yaw = math.atan2(math.sin(heading), math.cos(heading))
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = -translation[2], -translation[0]
    forward, leftward = -velocity[2], -velocity[0]
    yaw_rate = angular_velocity[1]
    vx, vy = cos * forward + sin * leftward, cos * leftward - sin * forward
    pose = (x - cos * mount.x + sin * mount.y, y - sin * mount.x - cos * mount.y, yaw)
    return pose, (vx + yaw_rate * mount.y, vy - yaw_rate * mount.x, yaw_rate)


def to_reading(data: Any, stamp: float, mount: CameraMount) -> Reading:
    """A reading of pyrealsense2's pose data."""
    pose, velocity = planar_motion(
        _triple(data.translation),
        (data.rotation.x, data.rotation.y, data.rotation.z, data.rotation.w),
        _triple(data.velocity),
        _triple(data.angular_velocity),
        mount,
    )
    return Reading(stamp, pose, velocity, data.tracker_confidence / FULL_CONFIDENCE)


def _triple(vector: Any) -> Triple:
    return vector.x, vector.y, vector.z


class T265(Sensor):
    """The camera, at 200 Hz; its stamps are brought to the monotonic clock.

    Args:
        mount: Where the camera is on the car.
        library: pyrealsense2, or what stands in for it; imported by default.

    Raises:
        ImportError: pyrealsense2 is not installed.
        OSError: There is no camera.
    """

    def __init__(self, mount: Optional[CameraMount] = None, library: Any = None) -> None:
        self._mount = mount or CameraMount()
        self._lock, self._clock = threading.Lock(), DeviceClock()
        self._last: Optional[Reading] = None
        self._waiting: Deque[Reading] = deque(maxlen=KEPT)
        self._library = _imported() if library is None else library
        config = self._library.config()
        config.enable_stream(self._library.stream.pose)
        self._pipeline = self._library.pipeline()
        self._open = True
        try:
            self._pipeline.start(config, self._heard)
        except RuntimeError as error:
            raise OSError(
                f"T265: {error}: plug it into a USB 3 port, wait 5 s, and close other programs "
                "that use it"
            ) from None

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "T265":
        """Makes a camera from settings: the fields of `CameraMount`."""
        return cls(section(CameraMount, settings, "sensor", RANGES))

    def latest(self) -> Optional[Reading]:
        with self._lock:
            return self._last

    def readings(self) -> List[Reading]:
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        return waiting

    def close(self) -> None:
        if self._open:
            self._open = False
            self._pipeline.stop()

    def _heard(self, frame: Any) -> None:
        """Called by the library, in a thread of its own, with each frame."""
        now = time.monotonic()
        pose = frame.as_pose_frame()
        if not pose:
            return  # another stream's frame
        stamp = self._clock.time(1e-3 * pose.get_timestamp(), now)  # of the frame: [ms]
        reading = to_reading(pose.get_pose_data(), stamp, self._mount)
        with self._lock:
            self._last = reading
            self._waiting.append(reading)


def _imported() -> Any:
    try:
        import pyrealsense2  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(
            "sensor.kind='t265' needs pyrealsense2, at most 2.53.1, the last with the T265: "
            "pip install pyrealsense2==2.53.1.4623, or build librealsense for the car's computer"
        ) from None
    return pyrealsense2
