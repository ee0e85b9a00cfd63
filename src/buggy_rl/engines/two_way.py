"""Force laws of commands with brakes and reverse, for tensors and NumPy arrays alike.

`speed` is that of the driven wheels [m/s], `drive` the command in -1..1, `values` the parameters.
"""

from collections.abc import Mapping
from typing import Any

ROLLS = 0.2  # [m/s] forward speed above which a two-way ESC brakes; fades into reverse; chosen
IDLE = 0.05  # [-] drive beyond the dead zone at which the drag brake is off; chosen

# name, lower, upper, unit, meaning; ranges and the values in `SHIPPED` are those of the buggy
BRAKES = (
    ("brake_force", 0.0, 50.0, "N", "Force of the brakes at full command, against the motion."),
    ("brake_front_share", 0.0, 1.0, "-", "Share of the brake force at the front axle."),
    ("drag_brake", 0.0, 20.0, "N", "Force of the brake without a command, against the motion."),
    ("reverse_share", 0.0, 1.5, "-", "Force of the motor in reverse over that forward."),
    ("reverse_deadband", 0.0, 0.5, "-", "Drive (0..1) of brake and reverse that does nothing."),
)
SHIPPED = {
    "brake_force": 8.0,  # [N] 0.5 g of 1.6 kg; chosen
    "brake_front_share": 0.0,  # [-] the motor brakes the rear axle; chosen
    "drag_brake": 0.0,  # [N] off, as controllers are shipped; chosen
    "reverse_share": 0.5,  # [-] controllers limit reverse to about half; chosen
    "reverse_deadband": 0.05,  # [-] as forward in the buggy's preset; chosen
}


def rolling_forward(vx: Any) -> Any:
    """Share 0..1 of a brake, and not of reverse, in a command below 0: min(max(vx / v0, 0), 1)."""
    return (vx / ROLLS).clip(0.0, 1.0)


def esc_drive(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of the motor behind a two-way ESC.

    F = (f0 - f1 v) max(0, d - z) - q max(0, f0 + f1 v) max(0, -d - z_r) (1 - rolls).

    `rolls` is `rolling_forward` of the car: that it has to stand before it reverses.
    """
    forward = (drive - values["throttle_deadband"]).clip(0.0)
    backward = (-drive - values["reverse_deadband"]).clip(0.0) * values["reverse_share"]
    lost = values["drive_force_loss"] * speed
    pulls = (values["drive_force"] - lost) * forward
    return pulls - (values["drive_force"] + lost).clip(0.0) * backward * (1 - rolls)


def esc_brakes(drive: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """Forces [N] >= 0 of the brake by the command, and of the drag brake without one."""
    forward = (drive - values["throttle_deadband"]).clip(0.0)
    backward = (-drive - values["reverse_deadband"]).clip(0.0)
    idle = (1 - (forward + backward) / IDLE).clip(0.0)
    return values["brake_force"] * backward, values["drag_brake"] * idle


def braking_force(vx: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of the brakes on a car at vx [m/s]: against the motion, 0 at rest."""
    pressed, dragging = esc_brakes(drive, values)
    return -(pressed * rolling_forward(vx) + dragging * (vx / ROLLS).clip(-1.0, 1.0))


def setpoint_force(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] behind a proportional controller whose setpoint v_full d may be negative.

    F = k (v_full d - v), in the direction of the motion at most f0 - f1 |v|, against it at most the
    brake force; `rolls` plays no part.
    """
    del rolls
    wanted = values["speed_gain"] * (values["full_speed"] * drive - speed)
    return _limited(wanted, speed, values, values["brake_force"])


def current_force(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of a motor whose current is commanded: F = f0 d, of either sign.

    In the direction of the motion back-EMF leaves at most f0 - f1 |v|; `rolls` plays no part.
    """
    del rolls
    return _limited(values["drive_force"] * drive, speed, values, values["drive_force"])


def _limited(force: Any, speed: Any, values: Mapping[str, Any], against: Any) -> Any:
    """A force within what the motor has along its motion, and `against` it; continuous at rest."""
    ahead = (0.5 + 0.5 * speed / ROLLS).clip(0.0, 1.0)
    lost = values["drive_force_loss"] * speed
    forward = (values["drive_force"] - lost).clip(0.0)
    backward = (values["drive_force"] + lost).clip(0.0)
    most = ahead * forward + (1 - ahead) * against
    least = ahead * against + (1 - ahead) * backward
    return force.clip(-least, most)
