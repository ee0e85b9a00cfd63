"""Faults of the sensor on demand: what becomes of a reading on its way to the car."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from buggy_rl.car.interfaces import Reading

LATE_ROWS = 15  # 0.15 s at 100 Hz: later than a car can be driven by
SPARSE_ROWS = 12  # one reading of so many: 8 Hz
STAMP_BACK = 0.03  # [s] of every second stamp
LOW_CONFIDENCE = 0.3  # in [0, 1]; the T265's "low" is 0.33


@dataclass
class Passage:
    """What a fault knows of the readings."""

    past: deque[Reading]
    """The readings so far, the present one last."""
    held: Reading
    """Reading before the fault began."""
    size: float
    """How bad: of a jump [m], of a step of the clock [s], of a drift [m/s]."""
    count: int = 0
    """Readings since the fault began."""


def _silent(passage: Passage) -> Reading | None:
    return None


def _frozen(passage: Passage) -> Reading | None:
    return passage.held._replace(stamp=passage.past[-1].stamp)


def _jumping(passage: Passage) -> Reading | None:
    x, y, yaw = passage.past[-1].pose
    angle = 2.4 * passage.size  # the direction of the jump follows its size
    pose = (x + passage.size * math.cos(angle), y + passage.size * math.sin(angle), yaw)
    return passage.past[-1]._replace(pose=pose)


def _sparse(passage: Passage) -> Reading | None:
    return None if passage.count % SPARSE_ROWS else passage.past[-1]


def _late(passage: Passage) -> Reading | None:
    return passage.past[max(-len(passage.past), -1 - LATE_ROWS)]


def _stamps_back(passage: Passage) -> Reading | None:
    back = STAMP_BACK if passage.count % 2 else 0.0
    return passage.past[-1]._replace(stamp=passage.past[-1].stamp - back)


def _velocity_frozen(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(velocity=passage.held.velocity)


def _pose_drifting(passage: Passage) -> Reading | None:
    x, y, yaw = passage.past[-1].pose
    way = passage.size * (passage.past[-1].stamp - passage.held.stamp)
    return passage.past[-1]._replace(pose=(x + way, y, yaw))


def _nan(passage: Passage) -> Reading | None:
    _, vy, yaw_rate = passage.past[-1].velocity
    return passage.past[-1]._replace(velocity=(math.nan, vy, yaw_rate))


def _unsure(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(confidence=LOW_CONFIDENCE)


def _clock_step(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(stamp=passage.past[-1].stamp + passage.size)


SENSOR_FAULTS: dict[str, Callable[[Passage], Reading | None]] = {
    "silent": _silent,
    "frozen": _frozen,
    "jumping": _jumping,
    "sparse": _sparse,
    "late": _late,
    "not_a_number": _nan,
    "unsure": _unsure,
    "clock_step": _clock_step,
    "stamps_back": _stamps_back,
    "velocity_frozen": _velocity_frozen,
    "pose_drifting": _pose_drifting,
}
"""Fault -> the reading that arrives, or None."""


class SensorChannel:
    """Passes readings on, spoilt while a fault lasts."""

    def __init__(self) -> None:
        self._past: deque[Reading] = deque(maxlen=LATE_ROWS + 1)
        self._fault: Callable[[Passage], Reading | None] | None = None
        self._until, self._passage = -math.inf, None

    def spoil(self, kind: str, until: float, size: float = 0.0) -> None:
        """Begins a fault that ends at a time [s].

        Raises:
            ValueError: There is no such fault, or no reading yet.
        """
        if kind not in SENSOR_FAULTS:
            raise ValueError(f"fault {kind!r}: must be one of {', '.join(SENSOR_FAULTS)}")
        if not self._past:
            raise ValueError(f"fault {kind!r}: no reading was measured yet")
        self._fault, self._until = SENSOR_FAULTS[kind], until
        self._passage = Passage(self._past, self._past[-1], size)

    def passed(self, reading: Reading) -> tuple[Reading | None, bool]:
        """The reading that arrives, if one does, and whether it is as it was measured."""
        self._past.append(reading)
        if self._fault is None or self._passage is None or reading.stamp > self._until:
            self._fault = None
            return reading, True
        self._passage.count += 1
        return self._fault(self._passage), False
