"""Checks of a recording, in order; each refuses it, or cuts rows and notes them.

Units and clock come first: leaps and velocities are only meaningful in the right units.
"""

from buggy_rl.recordings.checks.cells import check_geographic, check_leaps
from buggy_rl.recordings.checks.clock import (
    check_bunched,
    check_gaps,
    check_order,
    check_rate,
    check_usable_time,
)
from buggy_rl.recordings.checks.commands import (
    check_driven,
    check_rest,
    check_silence,
    check_steering_sign,
)
from buggy_rl.recordings.checks.heading import check_heading
from buggy_rl.recordings.checks.sensor import (
    check_frozen,
    check_linear,
    check_speed,
    check_spikes,
    check_yaw_rate,
)

CHECKS = (
    *(check_order, check_geographic, check_frozen, check_rate, check_bunched, check_gaps),
    *(check_speed, check_heading, check_rest, check_driven, check_leaps, check_spikes),
    *(check_linear, check_yaw_rate, check_steering_sign, check_silence, check_usable_time),
)
