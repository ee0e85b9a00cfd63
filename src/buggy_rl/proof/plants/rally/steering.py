"""Command dead times, servo, steering linkage with slack, and Ackermann geometry.

Sources: Milliken, chapter on steering systems (Ackermann geometry); the servo as a position loop
with first-order lag and speed limit; backlash as the play operator of hysteresis theory.
"""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, limit

PERIOD = 0.01
# Commands kept: dead times up to (HISTORY - 2) periods can be served.
HISTORY = 24


def push_command(history: Array, command: Array) -> Array:
    """Put the command [N, 2] of this period first; history [N, HISTORY, 2], newest first."""
    return np.concatenate([command[:, None, :], history[:, :-1, :]], axis=1)


def delayed_command(history: Array, column: int, dead_time: Array, elapsed: float) -> Array:
    """Command that acts now, [N]; column 0 throttle, 1 steering.

    dead_time [N] s; elapsed: seconds since the start of this control period. The command is held
    constant over each period, so a look-up by whole periods is exact.
    """
    # The small offset keeps times that fall on a period boundary on its later side.
    back = np.ceil((dead_time - elapsed) / PERIOD - 1e-6)
    index = limit(back, 0, HISTORY - 1).astype(int)
    return history[np.arange(len(index)), index, column]


def step_servo(k: Arrays, state: Arrays, inputs: Arrays, command: Array, dt: float) -> None:
    """Servo angle and rack angle one step later (both in rad at the wheels, [N]); writes.

    Lag towards the commanded angle with a speed limit, then the slack between servo and rack:
    the rack moves only when the servo has taken up the play.
    """
    target = k["lock"] * k["steer_gain"] * limit(command, -1.0, 1.0) + k["steer_offset"]
    stop = 1.25 * k["lock"]
    wanted = (limit(target, -stop, stop) - state["servo"]) * (dt / (dt + k["servo_lag"]))
    reach = dt * k["servo_rate"] * inputs["servo_rate"]
    servo = state["servo"] + limit(wanted, -reach, reach)
    half = 0.5 * k["slack"]
    state["servo"], state["rack"] = servo, limit(state["rack"], servo - half, servo + half)


def wheel_angles(k: Arrays, rack: Array, toe: Array) -> Array:
    """Steer angle of each wheel, rad [N, 4], positive to the left; toe [N, 4] is added.

    Ackermann: the cotangents of the inner and outer angle differ by track over wheelbase. The
    parameter "ackermann" is the share of that difference which the linkage realises.
    """
    tangent = np.tan(rack)
    part = 0.5 * k["ackermann"] * k["track"] / k["wheelbase"] * tangent
    angle = np.zeros_like(toe)
    angle[:, 0] = np.arctan(tangent / (1.0 - part))
    angle[:, 1] = np.arctan(tangent / (1.0 + part))
    return angle + toe
