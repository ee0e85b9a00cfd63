"""Excitation: conditions that were hardly driven, and effects that they would show."""

import torch

from buggy_rl.estimation.segments import Segments
from buggy_rl.similarity import Similarity
from buggy_rl.vehicle import wrap_angle

SHOWN = 0.03  # [-] share of the time from which a condition counts as driven
HEADINGS = 8  # sectors of the heading
FAST, SLOW, ROLLING, CRAWLING = 2.0, 1.0, 0.5, 0.1  # [m/s] of the buggy; chosen
BUGGY = Similarity()
QUICK = 5.0  # [1/s] change of the steering command that counts as quick; chosen


def weak(segments: Segments, similarity: Similarity = BUGGY) -> list[str]:
    """A line for each condition that was hardly or never driven, with the effects that it hides.

    Args:
        segments: What was driven.
        similarity: Of the car to the buggy, for which the speeds were chosen.
    """
    fast, slow, rolling, crawling = (similarity.speed * v for v in (FAST, SLOW, ROLLING, CRAWLING))
    rows = slice(segments.start, None)
    vx, yaw_rate = segments.smooth_velocity[:, rows, 0], segments.smooth_velocity[:, rows, 2]
    throttle, steering = segments.action[:, rows].unbind(-1)
    drive, lateral = (throttle + 1) / 2, (vx * yaw_rate).abs()
    yaw = wrap_angle(segments.smooth_pose[:, rows, 2])
    heading = ((yaw + torch.pi) / (2 * torch.pi) * HEADINGS).long().clamp(0, HEADINGS - 1)
    seen = torch.bincount(heading.flatten(), minlength=HEADINGS) / heading.numel()
    checks = (
        ("more than 0.6 of full drive", drive > 0.6, "motor_power_limit, top_speed"),
        (f"above {fast:g} m/s", vx > fast, "aerodynamic_drag, top_speed"),
        (
            f"below {slow:g} m/s",
            (vx < slow) & (vx > crawling),
            "rolling_resistance, throttle_deadband",
        ),
        (
            "coasting without drive",
            (drive < 0.05) & (vx > rolling),
            "rolling_resistance, viscous_drag, aerodynamic_drag apart from the throttle's effects",
        ),
        ("hard left turns", steering > 0.6, "steering_asymmetry"),
        ("hard right turns", steering < -0.6, "steering_asymmetry"),
        ("bends near the limit of grip (5 m/s^2)", lateral > 5.0, "tire_grip, grip_balance"),
        (
            "quick steering",
            segments.action[:, rows, 1].diff(dim=1).abs() > QUICK * segments.dt,
            "steering_dead_time from steering_lag, steering_rate_limit, steering_backlash",
        ),
        ("going straight", (steering.abs() < 0.1) & (vx > rolling), "steering_offset"),
    )
    found = [
        f"{what} hardly driven: hides {hides}"
        for what, mask, hides in checks
        if float(mask.double().mean()) < SHOWN
    ]
    if int((seen > 0.02).sum()) < HEADINGS:
        found.append("not all directions driven: hides floor_slope, wind")
    if float(torch.maximum(segments.elapsed, segments.session).max()) < 30.0:
        found.append("less than 30 s of one recording: hides battery_sag, thermal_foldback")
    return found
