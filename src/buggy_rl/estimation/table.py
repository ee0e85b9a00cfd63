"""The original study's table 7.1: every simulator over the same held-out windows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.estimation.open_loop import (
    OpenLoopError,
    bootstrap_interval,
    measured_motion,
    open_loop,
    open_loop_error,
)
from buggy_rl.estimation.segments import (
    CHANNELS,
    HORIZONS,
    Segments,
    cut_segments,
    segment_rows,
)
from buggy_rl.recordings.recording import Recording, refuse_another_rest
from buggy_rl.recordings.resampling import filtered

ORIGINAL = {  # 1 s position MSE [m^2] printed in the original study's table 7.1, on its own car
    "MLP": 0.0596,
    "MLP with history": 0.0592,
    "temporal CNN": 0.0376,
    "MuJoCo, tuned by hand": 0.0371,
    "MLP, mirrored": 0.095,
    "MLP, unfiltered": 0.105,
}


@dataclass(frozen=True)
class ComparedSimulator:
    """A simulator in the table."""

    name: str
    make: Callable[[int], EnvBase]
    """Builds it for a number of cars."""
    filter_width: int = 1
    """Rows of the past mean that filters the velocities at the start; 1: as measured."""


@dataclass(frozen=True)
class HeldOut:
    """Held-out segments of 0.3 s of warm-up and 3 s of rollout."""

    segments: Segments
    recordings: Sequence[Recording]
    """Recordings that the segments were cut from."""


def held_out_segments(recordings: Sequence[Recording], count: int) -> HeldOut:
    """Cuts at most `count` segments over whole held-out recordings.

    Raises:
        ValueError: The recordings are too short for a single one.
    """
    if count < 2:
        raise ValueError(f"a table needs at least 2 segments, got windows={count}")
    seconds, dt = max(HORIZONS), recordings[0].dt
    length = segment_rows(seconds, dt)
    total = sum(max(0, len(r) - length) for r in recordings)
    stride = max(1, total // (2 * count)) * dt
    return HeldOut(cut_segments(recordings, seconds, stride).spread(count), recordings)


def rollout_errors(candidate: ComparedSimulator, test: HeldOut) -> tuple[TensorDict, OpenLoopError]:
    """Rolls a simulator out along the test segments; its rollouts and their errors.

    Raises:
        ValueError: It takes another command than the recordings have.
    """
    refuse_another_rest(test.recordings, candidate.make(1))
    segments = replace(test.segments, smooth_pose=test.segments.pose)
    velocity = test.segments.velocity
    if candidate.filter_width > 1:
        velocity = _filtered_velocity(test, candidate.filter_width)
    made = open_loop(candidate.make, replace(segments, smooth_velocity=velocity))
    return made, open_loop_error(made, measured_motion(segments), segments.dt)


def _filtered_velocity(test: HeldOut, width: int) -> torch.Tensor:
    smooth = [filtered(r, width).data[keys.VELOCITY] for r in test.recordings]
    starts = zip(test.segments.recording.tolist(), test.segments.row.tolist(), strict=True)
    length = test.segments.pose.shape[1]
    return torch.stack([smooth[index][row : row + length] for index, row in starts])


def table_row(name: str, error: OpenLoopError, groups: torch.Tensor) -> dict[str, float | str]:
    """One line of the table: MSE with its interval, and errors by channel and horizon.

    The median is over windows of each one's root mean square distance: a few fast windows, which
    decide a mean of squares, do not decide it.
    """
    low, high = bootstrap_interval(error.position_mse[1.0], groups)
    row: dict[str, float | str] = {
        "simulator": name,
        "position_mse_1s": error.position_mse[1.0].mean().item(),
        "low": low,
        "high": high,
        "position_median_1s": error.position_mse[1.0].sqrt().median().item(),
    }
    for horizon in error.position:
        row[f"position_{horizon:g}s"] = error.position[horizon].mean().item()
        row[f"yaw_{horizon:g}s"] = error.yaw[horizon].mean().item()
        rms = error.velocity_mse[horizon].mean(0).sqrt()
        for channel, value in zip(CHANNELS, rms.tolist(), strict=True):
            row[f"{channel}_{horizon:g}s"] = value
    row["furthest_speed"] = error.furthest.max().item()
    return row


def markdown(rows: Sequence[Mapping[str, Any]], windows: int, drives: int) -> str:
    """The table as Markdown, best first."""
    ordered = sorted(rows, key=lambda row: row["position_mse_1s"])
    lines = [
        f"Over {windows} windows of {drives} held-out drives; intervals are 95 %, bootstrapped over"
        " blocks of windows.",
        "",
        "| simulator | 1 s position MSE [m²] | 95 % interval | 1 s median [m]"
        " | error after 0.3 / 1 / 3 s [m] | heading after 0.3 / 1 / 3 s [rad] |",
        "|---|---|---|---|---|---|",
    ]
    for r in ordered:
        lines.append(
            f"| {r['simulator']} | {r['position_mse_1s']:.5f} | {r['low']:.5f} - {r['high']:.5f}"
            f" | {r['position_median_1s']:.4f} | {_by_horizon(r, 'position')}"
            f" | {_by_horizon(r, 'yaw')} |"
        )
    lines += [
        "",
        "Root mean square error of the velocities over 0.3 / 1 / 3 s:",
        "",
        "| simulator | vx [m/s] | vy [m/s] | yaw rate [rad/s] |",
        "|---|---|---|---|",
    ]
    for r in ordered:
        channels = " | ".join(_by_horizon(r, channel) for channel in CHANNELS)
        lines.append(f"| {r['simulator']} | {channels} |")
    lines += ["", "The original study's printed figures, on its own car (1 s position MSE, m²): "]
    lines[-1] += ", ".join(f"{name} {value}" for name, value in ORIGINAL.items()) + "."
    return "\n".join(lines) + "\n"


def _by_horizon(row: Mapping[str, Any], what: str) -> str:
    return " / ".join(f"{row[f'{what}_{horizon:g}s']:.3f}" for horizon in HORIZONS)
