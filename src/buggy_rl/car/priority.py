"""Real-time priority: other programs on the computer do not delay control."""

import os
import sys

# Priorities of SCHED_FIFO, 1..99; kernel threads that drive I2C have 50.
SIMULATION, LOOP, WATCHDOG = 10, 20, 30
# [s] after which a thread lets another run; Python's own 5 ms is half a period.
SWITCH_INTERVAL = 5e-4


def take_priority(priority: int) -> bool:
    """Runs this process, and the threads it makes from now on, before all ordinary ones.

    Returns:
        Whether the system allows it: root, or a limit `rtprio` in /etc/security/limits.conf.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, AttributeError):  # the latter: no Linux
        return False
    return True


def has_priority() -> bool:
    """Whether `take_priority` was allowed in this process."""
    return hasattr(os, "SCHED_FIFO") and os.sched_getscheduler(0) == os.SCHED_FIFO
