"""The original study's table 7.1: every simulator over the same held-out windows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.estimation.segments import CHANNELS, HORIZONS, WARM_UP
from buggy_rl.identification.open_loop import (
    OpenLoopError,
    bootstrap_interval,
    open_loop,
    open_loop_error,
)
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.windows import filtered, windows

ORIGINAL = {  # 1 s position MSE [m^2] printed in the original study's table 7.1, on its own car
    "MLP": 0.0596,
    "MLP with history": 0.0592,
    "temporal CNN": 0.0376,
    "MuJoCo, tuned by hand": 0.0371,
    "MLP, mirrored": 0.095,
    "MLP, unfiltered": 0.105,
}


@dataclass(frozen=True)
class Candidate:
    """A simulator in the table."""

    name: str
    make: Callable[[int], EnvBase]
    """Builds it for a number of cars."""
    filter_width: int = 1
    """It is started from velocities filtered by a past mean of so many rows; 1: as measured."""


@dataclass(frozen=True)
class TestWindows:
    """Held-out stretches of 0.3 s of warm-up and 3 s of rollout."""

    rows: TensorDictBase
    """[N, L] as measured."""
    recordings: Sequence[Recording]
    """The drives they were cut from."""

    @property
    def measured(self) -> TensorDictBase:
        """What a rollout is compared with, [N, L - WARM_UP]."""
        return self.rows[:, WARM_UP:]

    def groups(self) -> torch.Tensor:
        """[N] Windows with the same number overlap in time."""
        return block_numbers(self.rows)


def block_numbers(rows: TensorDictBase) -> torch.Tensor:
    """[N] A number for each window [N, L], shared by those whose starts lie within one length."""
    drive, first = rows[keys.RECORDING][:, 0], rows[keys.ROW][:, 0]
    return drive * 1_000_000 + first // rows.batch_size[1]


def thinned(rows: TensorDictBase, count: int) -> TensorDictBase:
    """At most `count` windows, spread evenly."""
    if len(rows) <= count:
        return rows
    return rows[torch.linspace(0, len(rows) - 1, count).round().long()]


def held_out_windows(recordings: Sequence[Recording], count: int) -> TestWindows:
    """At most `count` windows over whole held-out drives.

    Raises:
        ValueError: The drives are too short for a single one.
    """
    if count < 2:
        raise ValueError(f"a table needs at least 2 windows, got windows={count}")
    length = WARM_UP + round(max(HORIZONS) / recordings[0].dt) + 1
    total = sum(max(0, len(r) - length) for r in recordings)
    stride = max(1, total // (2 * count))
    return TestWindows(thinned(windows(recordings, length, stride), count), recordings)


def judge(candidate: Candidate, test: TestWindows) -> tuple[TensorDictBase, OpenLoopError]:
    """Plays the test windows into a simulator; returns its rollouts and their errors."""
    start = None
    if candidate.filter_width > 1:
        start = _filtered_start(test, candidate.filter_width)
    made = open_loop(candidate.make, test.rows, start)
    return made, open_loop_error(made, test.measured, test.recordings[0].dt)


def _filtered_start(test: TestWindows, width: int) -> torch.Tensor:
    smooth = [filtered(r, width).data[keys.VELOCITY] for r in test.recordings]
    first, drive = test.rows[keys.ROW][:, 0], test.rows[keys.RECORDING][:, 0]
    rows = zip(drive.tolist(), first.tolist(), strict=True)
    return torch.stack([smooth[d][f : f + WARM_UP + 1] for d, f in rows])


def table_row(name: str, error: OpenLoopError, groups: torch.Tensor) -> dict[str, float | str]:
    """One line of the table: MSE with its interval, and errors by channel and horizon."""
    low, high = bootstrap_interval(error.position_mse[1.0], groups)
    row: dict[str, float | str] = {
        "simulator": name,
        "position_mse_1s": error.position_mse[1.0].mean().item(),
        "low": low,
        "high": high,
    }
    for horizon in error.position:
        row[f"position_{horizon:g}s"] = error.position[horizon].mean().item()
        row[f"yaw_{horizon:g}s"] = error.yaw[horizon].mean().item()
        rms = error.velocity_mse[horizon].mean(0).sqrt()
        for channel, value in zip(CHANNELS, rms.tolist(), strict=True):
            row[f"{channel}_{horizon:g}s"] = value
    row["furthest_speed"] = error.furthest.max().item()
    return row


def markdown(rows: Sequence[Mapping[str, float | str]], windows: int, drives: int) -> str:
    """The table as Markdown, best first."""
    ordered = sorted(rows, key=lambda row: row["position_mse_1s"])
    lines = [
        f"Over {windows} windows of {drives} held-out drives; intervals are 95 %, bootstrapped over"
        " blocks of windows.",
        "",
        "| simulator | 1 s position MSE [m²] | 95 % interval | error after 0.3 / 1 / 3 s [m]"
        " | heading after 0.3 / 1 / 3 s [rad] |",
        "|---|---|---|---|---|",
    ]
    for r in ordered:
        lines.append(
            f"| {r['simulator']} | {r['position_mse_1s']:.5f} | {r['low']:.5f} - {r['high']:.5f}"
            f" | {_by_horizon(r, 'position')} | {_by_horizon(r, 'yaw')} |"
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


def _by_horizon(row: Mapping[str, float | str], what: str) -> str:
    return " / ".join(f"{row[f'{what}_{horizon:g}s']:.3f}" for horizon in HORIZONS)
