"""One drive as a TensorDict over time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDict

from buggy_rl.longitudinal import ONE_WAY, LongitudinalCommand


@dataclass
class Recording:
    """One drive at a uniform control period, checked.

    Rows of `data` [T]:

    - `t` [T, 1] float64: time [s], uniform within a segment, on the grid of `dt`.
    - `pose` [T, 3] float32: x, y [m], yaw [rad], world frame; yaw is unwrapped within a segment.
    - `velocity` [T, 3] float32: vx, vy [m/s], yaw_rate [rad/s], body frame.
    - `action` [T, 2] float32: throttle, steering in [-1, 1].
    - `segment` [T] int64: 0, 1, ...; every gap or cut starts a new one.
    - `wheel_speed` [T, 1] float32, where recorded: m/s at the tread; NaN where there is no value.
    - `gyro` [T, 1] float32, where recorded: yaw rate by a gyroscope [rad/s]; likewise.
    """

    name: str
    """Name in tables and splits: that of the file, without folder and ending."""
    data: TensorDict
    dt: float
    """Control period [s]."""
    source: str = ""
    """The file."""
    notes: list[str] = field(default_factory=list)
    """What was cut or derived while reading, one line each."""
    command: LongitudinalCommand = ONE_WAY
    """What the throttle is; one with reverse is at rest at 0."""
    since_first: float = 0.0
    """Time from the beginning of the session's first recording to that of this one [s]; 0 where the
    stamps do not tell."""
    derived: tuple[str, ...] = ()
    """Columns of the velocity that no sensor measured: they follow from the pose."""

    @property
    def duration(self) -> float:
        """Recorded time without gaps [s]."""
        return len(self) * self.dt

    def __len__(self) -> int:
        return self.data.batch_size[0]


def refuse_another_rest(recordings: Sequence[Recording], simulator: Any) -> None:
    """Refuses recordings whose commands a simulator takes in another sense.

    A simulator that does not say what it takes, by an attribute `command`, is not judged.

    Raises:
        ValueError: No drive is 0 of one and -1 of the other.
    """
    takes = getattr(simulator, "command", None)
    if not isinstance(takes, LongitudinalCommand):
        return
    for recording in recordings:
        if recording.command.rest != takes.rest:
            raise ValueError(
                f"{recording.name} has the command {recording.command}, whose rest is "
                f"{recording.command.rest:g}; the simulator takes {takes}, whose rest is "
                f"{takes.rest:g}: declare one command in the column map and in the simulator's "
                "options, or name the car (car=...) of both"
            )
