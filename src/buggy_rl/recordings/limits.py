"""Where a measurement stops being believable; every threshold with its unit and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Thresholds of the checks. They bound what a small car and an honest tracker can do."""

    slowest_rate: float = 20.0
    """[Hz] Contract; a steering lag of 0.1 s is not seen below."""
    gap_periods: float = 1.75
    """Nominal periods; one dropped frame makes 2. An honest clock stays within 1.3 (DART)."""
    gap_jitter: float = 6.0
    """Robust standard deviations of the period that a jittery clock is granted on top of 1."""
    gap_most: float = 3.0
    """Nominal periods; above this it is a gap however jittery the clock."""
    bunched_periods: float = 0.2
    """Nominal periods; rows closer than this were stamped on delivery, not on measurement."""
    top_speed: float = 15.0
    """[m/s] Half as much again as the fastest that cars of this class are driven."""
    moving_speed: float = 0.3
    """[m/s] 3 mm a row at 100 Hz: no tracker repeats its pose to the last bit at that speed."""
    repeat_share: float = 0.2
    """Of the rows; more short repeats than this and the pose is slower than the rows."""
    leap: float = 0.02
    """[m] Off the path in one row; tracker noise is a tenth of it, a relocalisation more."""
    leap_acceleration: float = 20.0
    """[m/s^2] 2 g, twice what rubber on a floor gives; widens `leap` with the row period."""
    leap_yaw: float = 0.15
    """[rad] Off the turn in one row, 15 rad/s at 100 Hz; a small car turns at up to 7 rad/s."""
    leap_yaw_acceleration: float = 200.0
    """[rad/s^2] Full tyre force at both axles against a yaw inertia of 0.005 kg m^2."""
    leap_speed: float = 1.0
    """[m/s] Off its neighbours in one row, of a measured velocity."""
    leap_yaw_rate: float = 3.0
    """[rad/s] Off its neighbours in one row, of a measured yaw rate."""
    leap_sigmas: float = 10.0
    """Robust standard deviations of the drive's own noise that are granted on top."""
    leap_window: float = 0.05
    """[s] Each side, over which the neighbours' median is taken."""
    glitch_duration: float = 0.1
    """[s] A leap that comes back within this is a glitch, otherwise a teleport."""
    quaternion_norm: float = 0.01
    """Distance of the norm from 1; three printed decimals make 0.002."""
    tilt: float = 0.785
    """[rad] 45 degrees: a car that leans further is a quaternion in another order or frame."""
    tilt_share: float = 0.1
    """Of the rows; a car that rolls over now and then leans for less."""
    command_excess: float = 0.005
    """Outside the stated range; less is rounding and is clipped with a note."""
    heading_agreement: float = 0.7
    """Mean cosine between heading and course while moving: 45 degrees of mean sideslip."""
    mount_yaw: float = 0.1
    """[rad] Mean sideslip when driving straight above which a mounting error is pointed out."""
    agreement_window: float = 0.5
    """[s] Over which the distance travelled and the integrated velocity are compared."""
    agreement_distance: float = 0.05
    """[m] Granted; a relocalisation that `leap` lets pass plus noise."""
    agreement_angle: float = 0.1
    """[rad] Granted between yaw and integrated yaw rate."""
    agreement_share: float = 0.35
    """Of the distance or angle, granted: lever arms, mounting and scale errors of a sensor."""
    agreement_lag: float = 0.2
    """[s] Either way, granted between the two sensors of a drive."""
    agreement_sigmas: float = 5.0
    """Standard deviations of the white noise of both sensors, granted on top."""
    disagreeing_share: float = 0.02
    """Of the windows; less is isolated and cut, more refuses the drive."""
    missing_share: float = 0.1
    """Of the rows; a tracker that has no value for more than a tenth is refused."""
    cut_share: float = 0.5
    """Of the rows; a drive of which more had to be cut is refused."""
    command_hold: float = 0.1
    """[s] A command older than this is unknown; drivers' radios repeat at 10 Hz or faster."""
    shortest_segment: float = 0.2
    """[s] Shorter stretches are dropped: the smoother needs 0.15 s."""
    shortest_drive: float = 1.0
    """[s] What must be left in all; the shortest window that a simulator is judged on."""
