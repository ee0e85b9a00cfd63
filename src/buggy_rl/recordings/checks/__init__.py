"""Checks on the way in: each its own function, that refuses a drive or cuts rows and says so.

The order matters: units and clocks first, because a leap is only one if they are right.
"""

from buggy_rl.recordings.checks.agreement import check_linear, check_yaw_rate
from buggy_rl.recordings.checks.clock import check_bunched, check_gaps, check_order, check_rate
from buggy_rl.recordings.checks.commands import check_steering_sign
from buggy_rl.recordings.checks.heading import check_heading
from buggy_rl.recordings.checks.leaps import check_leaps
from buggy_rl.recordings.checks.sensor import check_frozen, check_speed, check_spikes
from buggy_rl.recordings.checks.whole import check_left
from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.limits import Limits

CHECKS = (
    *(check_order, check_frozen, check_rate, check_bunched, check_gaps),
    *(check_speed, check_heading, check_leaps, check_spikes),
    *(check_linear, check_yaw_rate, check_steering_sign, check_left),
)


def check(drive: Drive, limits: Limits) -> None:
    """Runs every check; rows are cut in place.

    Raises:
        RecordingError: The drive cannot be trusted.
    """
    for one in CHECKS:
        one(drive, limits)
