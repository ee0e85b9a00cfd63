"""Commands and measurements that come late.

u(t) = u'(t - d), so u'(t) = u(t + d); y'(t) = y(t - d). Dead times are whole rows: what lies
between two rows was not recorded.
"""

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.proof.real.edits.base import Edit, LogRows, whole_rows

LONGEST = 20  # [rows] 0.2 s: twice what radio and servo of a small car need together
LONGEST_OF_A_SENSOR = 8  # [rows] two frames and a half at 30 Hz


class DeadTimeEdit(Edit):
    """A command that acts late: its column is moved earlier."""

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"dead_time": whole_rows(chance, 1, LONGEST, CONTROL_PERIOD)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        late = round(values["dead_time"] / rows.dt)
        column = getattr(rows, self.varies)[late:]
        return replace(rows.between(0, len(column)), **{self.varies: column})


class SteeringDeadTimeEdit(DeadTimeEdit):
    """Steering that acts late."""

    name: ClassVar[str] = "steering_dead_time"
    mechanism: ClassVar[str] = "steering timing"
    varies: ClassVar[str] = "steering"


class ThrottleDeadTimeEdit(DeadTimeEdit):
    """A throttle that acts late."""

    name: ClassVar[str] = "throttle_dead_time"
    mechanism: ClassVar[str] = "throttle timing"
    varies: ClassVar[str] = "throttle"


class SensorLatencyEdit(Edit):
    """Measurements that are stamped late."""

    name: ClassVar[str] = "sensor_latency"
    mechanism: ClassVar[str] = "sensor timing"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"dead_time": whole_rows(chance, 1, LONGEST_OF_A_SENSOR, CONTROL_PERIOD)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        late = round(values["dead_time"] / rows.dt)
        shown = rows.between(0, max(0, len(rows) - late))
        later = rows.between(late, len(rows))
        return replace(later, pose=shown.pose, velocity=shown.velocity)
