"""One drive as a TensorDict over time, its limits, and the error of one that cannot be used."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tensordict import TensorDict

from buggy_rl.core.car_file import CarFile
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand


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
    """File that it was read from."""
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


class RecordingError(ValueError):
    """A recording is refused; one line names file, row, column, value and remedy.

    Rows count from 0 below the header, as in pandas: row r of a CSV file is on line r + 2.

    Args:
        file: The recording.
        message: What is wrong, with the value, and after a semicolon what to do.
        row: Row in the file; None for all.
        column: Column as the file names it; None for all.
    """

    def __init__(
        self, file: str, message: str, row: int | None = None, column: str | None = None
    ) -> None:
        self.file, self.row, self.column = file, row, column
        rows = "all rows" if row is None else f"row {row}"
        columns = "all columns" if column is None else f"column {column}"
        super().__init__(" ".join(f"recording {file}, {rows}, {columns}: {message}".split()))


TOP_SPEED_MARGIN = 1.5  # [-] of the car's top speed that no recording exceeds; see `top_speed`


@dataclass(frozen=True)
class Limits:
    """Thresholds with unit, meaning and evidence; they bound a small car and a sound tracker."""

    slowest_rate: float = 20.0
    """[Hz] Lowest sample rate; a steering lag of 0.1 s is not observable below it."""
    gap_periods: float = 1.75
    """[nominal periods] Longest step; one dropped frame makes 2, DART's steady clock up to 1.3."""
    gap_jitter: float = 6.0
    """[robust standard deviations of the period] Granted to a jittering clock beyond 1 period."""
    gap_most: float = 3.0
    """[nominal periods] Longest step whatever the jitter: two lost frames."""
    bunched_periods: float = 0.2
    """[nominal periods] Shortest step; closer rows were stamped on delivery."""
    top_speed: float = 15.0
    """[m/s] Highest speed; 1.5 times the fastest that cars of this class are driven."""
    moving_speed: float = 0.3
    """[m/s] Speed of a moving car: 3 mm a row at 100 Hz, where no tracker repeats its pose."""
    repeat_share: float = 0.2
    """Share of rows that briefly repeat the pose; more is a tracker slower than the rows."""
    leap: float = 0.02
    """[m] Deviation of position from the path in one row; ten times a tracker's noise."""
    leap_acceleration: float = 20.0
    """[m/s^2] Widens `leap` with the row period: 2 g, twice the grip of rubber."""
    leap_yaw: float = 0.15
    """[rad] Deviation of yaw in one row: 15 rad/s at 100 Hz, twice a small car's 7 rad/s."""
    leap_yaw_acceleration: float = 200.0
    """[rad/s^2] Widens `leap_yaw`: full tyre force at both axles, yaw inertia 0.005 kg m^2."""
    leap_speed: float = 1.0
    """[m/s] Deviation of a measured velocity from its neighbours in one row: 10 g at 100 Hz."""
    leap_yaw_rate: float = 3.0
    """[rad/s] Deviation of a measured yaw rate from its neighbours in one row: 300 rad/s^2."""
    leap_sigmas: float = 10.0
    """[robust standard deviations of the recording's noise] Granted beyond the leap limits."""
    leap_window: float = 0.05
    """[s] On each side of a row, over which the neighbours' median is taken: 5 rows at 100 Hz."""
    glitch_duration: float = 0.1
    """[s] A leap that returns within this time is a glitch, otherwise a teleport."""
    quaternion_norm: float = 0.01
    """Deviation of a quaternion's norm from 1; printing three decimals makes 0.002."""
    tilt: float = 0.785
    """[rad] Tilt (45 degrees) above which a quaternion has another order or frame."""
    tilt_share: float = 0.1
    """Share of tilted rows above which a recording is refused; a roll-over is shorter."""
    command_excess: float = 0.005
    """Command outside its stated range that is rounding, and clipped with a note."""
    heading_agreement: float = 0.7
    """Least mean cosine of course minus yaw while moving: 45 degrees of mean sideslip."""
    mount_yaw: float = 0.1
    """[rad] Median sideslip on a straight above which a mounting error is noted."""
    agreement_window: float = 0.5
    """[s] Over which a pose change and its integrated rate are compared."""
    agreement_distance: float = 0.05
    """[m] Granted between distance and integrated velocity: a leap below `leap`, plus noise."""
    agreement_angle: float = 0.1
    """[rad] Granted between the change of yaw and the integrated yaw rate."""
    agreement_share: float = 0.35
    """Share of the distance or angle, granted for lever arm, mounting and scale of a sensor."""
    agreement_lag: float = 0.2
    """[s] Lag of either sign granted between pose and velocity sensors."""
    agreement_sigmas: float = 5.0
    """[standard deviations of both sensors' white noise] Granted on top."""
    disagreeing_share: float = 0.02
    """Share of windows; fewer are cut, more refuse the recording."""
    zero_rest_share: float = 0.8
    """Share of the rows at a throttle of 0 in which the car stands or slows down, above which 0 is
    no half drive but rest; 1 admits it. Chosen: 0.95 where it is, 0.5 and less where not."""
    undriven_gain: float = 1.0
    """[m/s] Speed that a car gains from a standstill, without any drive, when it is pushed; a
    slope of 5 % takes 1 m for it."""
    missing_share: float = 0.1
    """Share of rows without a tracker value above which a recording is refused."""
    cut_share: float = 0.5
    """Share of rows cut above which a recording is refused."""
    command_hold: float = 0.1
    """[s] Longest validity of a command; radios repeat theirs at 10 Hz or faster."""
    shortest_segment: float = 0.2
    """[s] Shorter segments are dropped; the Savitzky-Golay filter needs 0.15 s."""
    shortest_drive: float = 1.0
    """[s] Least usable time of a recording: the horizon of the open-loop error."""

    def for_car(self, car: CarFile) -> "Limits":
        """The limits of another car, where they are at their defaults.

        The top speed is 1.5 times the car's. A smaller car yaws faster, by 1 / length.
        """
        standard, agility = Limits(), max(1.0, 1 / car.similarity.length)
        scaled = {
            "top_speed": TOP_SPEED_MARGIN * car.top_speed,
            "leap_yaw": agility * self.leap_yaw,
            "leap_yaw_acceleration": agility * self.leap_yaw_acceleration,
        }
        own = {n: v for n, v in scaled.items() if getattr(self, n) == getattr(standard, n)}
        return replace(self, **own)
