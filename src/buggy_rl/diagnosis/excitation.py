"""Excitation: conditions that were hardly driven, and effects that they would show."""

import torch

from buggy_rl.estimation.segments import WARM_UP, Segments
from buggy_rl.vehicle import wrap_angle

SHOWN = 0.03  # [-] share of the time from which a condition counts as driven
HEADINGS = 8  # sectors of the heading


def weak(segments: Segments) -> list[str]:
    """A line for each condition that was hardly or never driven, with the effects that it hides."""
    rows = slice(WARM_UP, None)
    vx, yaw_rate = segments.smooth_velocity[:, rows, 0], segments.smooth_velocity[:, rows, 2]
    throttle, steering = segments.action[:, rows].unbind(-1)
    drive, lateral = (throttle + 1) / 2, (vx * yaw_rate).abs()
    yaw = wrap_angle(segments.smooth_pose[:, rows, 2])
    heading = ((yaw + torch.pi) / (2 * torch.pi) * HEADINGS).long().clamp(0, HEADINGS - 1)
    seen = torch.bincount(heading.flatten(), minlength=HEADINGS) / heading.numel()
    checks = (
        ("more than 0.6 of full drive", drive > 0.6, "motor_power_limit, top_speed"),
        ("above 2 m/s", vx > 2.0, "aerodynamic_drag, top_speed"),
        ("below 1 m/s", (vx < 1.0) & (vx > 0.1), "rolling_resistance, throttle_deadband"),
        (
            "coasting without drive",
            (drive < 0.05) & (vx > 0.5),
            "rolling_resistance, viscous_drag, aerodynamic_drag apart from the throttle's effects",
        ),
        ("hard left turns", steering > 0.6, "steering_asymmetry"),
        ("hard right turns", steering < -0.6, "steering_asymmetry"),
        ("bends near the limit of grip (5 m/s^2)", lateral > 5.0, "tire_grip, grip_balance"),
        (
            "quick steering",
            segments.action[:, WARM_UP:, 1].diff(dim=1).abs() > 0.05,
            "steering_dead_time from steering_lag, steering_rate_limit, steering_backlash",
        ),
        ("going straight", (steering.abs() < 0.1) & (vx > 0.5), "steering_offset"),
    )
    found = [
        f"{what} hardly driven: hides {hides}"
        for what, mask, hides in checks
        if float(mask.double().mean()) < SHOWN
    ]
    if int((seen > 0.02).sum()) < HEADINGS:
        found.append("not all directions driven: hides floor_slope, wind")
    if float(segments.elapsed.max()) < 30.0:
        found.append("less than 30 s of one recording: hides battery_sag")
    return found
