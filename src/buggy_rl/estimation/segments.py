"""What drives are compared by: stretches of about a second, and how noisily they were measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import torch
from scipy.signal import savgol_coeffs
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.recordings import Recording
from buggy_rl.recordings.windows import filtered, local_parabola, windows
from buggy_rl.vehicle import rotate

WARM_UP = 30  # rows (0.3 s) of measured motion imposed before a rollout: hidden states settle
HORIZONS = (0.3, 1.0, 3.0)  # [s]
CHANNELS = ("vx", "vy", "yaw_rate")
AHEAD = 30  # rows known beyond a stretch's start, for sensors that report late
EARLIER = 300  # rows before a stretch that tell where play in a linkage lies
SMOOTHING = 15  # rows of the parabola through what was measured: keeps what a car can do
# Correlations of noise that are told apart: what lasts longer than 2/3 of the parabola looks alike.
COLOURS = tuple(math.exp(-1.5 * k / SMOOTHING) for k in (math.inf, *np.geomspace(20, 1, 40)))
FAINT = 0.3  # and what is less than this may be the car


@dataclass(frozen=True)
class Stretches:
    """N stretches of drives, L = WARM_UP + H + 1 rows each; row WARM_UP is where rollouts start."""

    pose: Tensor
    """[N, L, 3] as measured; x, y [m], yaw [rad], not wrapped."""
    velocity: Tensor
    """[N, L, 3] as measured [m/s, rad/s]."""
    smooth_pose: Tensor
    """[N, L, 3] with most of the noise taken off."""
    smooth_velocity: Tensor
    """[N, L, 3] likewise."""
    action: Tensor
    """[N, L, 2]"""
    earlier: Tensor
    """[N, EARLIER, 2] actions before row 0; the first of a drive stands for those before it."""
    elapsed: Tensor
    """[N] time since the drive began, at row 0 [s]."""
    drive: Tensor
    """[N] int, which drive."""
    row: Tensor
    """[N] int, row 0's place in its drive."""
    dt: float
    """[s]"""

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def horizon(self) -> int:
        """Rows that a rollout covers."""
        return self.pose.shape[1] - WARM_UP - 1

    @property
    def seen_from_start(self) -> Tensor:
        """Measured motion [N, H, 6] of the rollouts, places from where they start, x ahead."""
        start = self.smooth_pose[:, WARM_UP : WARM_UP + 1]
        pose, velocity = self.pose[:, WARM_UP + 1 :], self.velocity[:, WARM_UP + 1 :]
        way = pose[..., :2] - start[..., :2]
        place = rotate(way, -start[..., 2].expand(way.shape[:-1]))
        return torch.cat([place, pose[..., 2:] - start[..., 2:], velocity], -1)

    def __getitem__(self, index: Tensor) -> "Stretches":
        parts = {n: value[index] for n, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **parts)


def stretches(recordings: Sequence[Recording], seconds: float, stride: float) -> Stretches:
    """Cuts drives into stretches.

    Args:
        recordings: Drives, all with the same control period.
        seconds: Length of a rollout.
        stride: From the start of one to the start of the next [s].

    Raises:
        ValueError: No drive has a stretch of that length without a gap.
    """
    dt = recordings[0].dt
    length = WARM_UP + round(seconds / dt) + 1
    smooth = [_smoothed(recording) for recording in recordings]
    cut = windows(recordings, length, max(1, round(stride / dt)))
    soft = windows(smooth, length, max(1, round(stride / dt)))
    row, drive = cut[keys.ROW][:, 0], cut[keys.RECORDING][:, 0]
    begun = torch.stack([recording.data[keys.TIME][0, 0] for recording in recordings])
    times = [
        recordings[d].data[keys.TIME][r, 0]
        for d, r in zip(drive.tolist(), row.tolist(), strict=True)
    ]
    return Stretches(
        pose=cut[keys.POSE],
        velocity=cut[keys.VELOCITY],
        smooth_pose=soft[keys.POSE],
        smooth_velocity=soft[keys.VELOCITY],
        action=cut[keys.ACTION],
        earlier=torch.stack(
            [_earlier(recordings[d], r) for d, r in zip(drive.tolist(), row.tolist(), strict=True)]
        ),
        elapsed=(torch.stack(times) - begun[drive]).float(),
        drive=drive,
        row=row,
        dt=dt,
    )


def _earlier(recording: Recording, row: int) -> Tensor:
    told = recording.data[keys.ACTION][max(0, row - EARLIER) : row + 1]
    return torch.cat([told[:1].expand(EARLIER + 1 - len(told), -1), told])[:-1]


def _smoothed(recording: Recording) -> Recording:
    soft = filtered(recording, SMOOTHING, local_parabola)
    data = soft.data
    for segment in data[keys.SEGMENT].unique():
        rows = data[keys.SEGMENT] == segment
        data[keys.POSE][rows] = local_parabola(data[keys.POSE][rows], SMOOTHING)
    return Recording(soft.name, TensorDict(data.to_dict(), data.batch_size), soft.dt)


def sensor_noise(cut: Stretches) -> Tensor:
    """Standard deviation [6] of x, y, yaw, vx, vy, yaw_rate of a row.

    What a parabola over `SMOOTHING` rows leaves, in the median over the rows, and made up for the
    share of the noise that such a parabola follows.
    """
    spread = 1.4826 * _rest(cut).flatten(0, 1).abs().median(0).values
    floor = torch.tensor([1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3])  # [m, rad, m/s, rad/s] rounding
    return torch.maximum(spread / followed(colour(cut)).left ** 0.5, floor)


def start_noise(cut: Stretches) -> Tensor:
    """Standard deviation [6] of a smoothed row, from which a rollout starts."""
    return followed(colour(cut)).kept ** 0.5 * sensor_noise(cut)


def colour(cut: Stretches) -> float:
    """Correlation rho of the noise from row to row, the same in all channels; 0 for white noise.

    By how often two rows that follow one another lie on the same side of their parabolas: of
    Gaussian noise P = 1/2 + asin(r) / pi. Of the channels the middle one counts, since in some
    the car itself moves faster than a parabola; and `FAINT` colour is taken for none.
    """
    rest = _rest(cut)
    same = ((rest[:, 1:] * rest[:, :-1]) > 0).double().mean((0, 1))  # (6,)
    seen = float(torch.sin(torch.pi * (same - 0.5)).median())
    rho = float(np.interp(seen, [followed(r).along for r in COLOURS], COLOURS))
    return rho if rho >= FAINT else 0.0


@dataclass(frozen=True)
class Followed:
    """What a parabola over `SMOOTHING` rows makes of noise of variance 1."""

    kept: float
    """Variance of the parabola's middle."""
    left: float
    """Variance of what it leaves."""
    along: float
    """Correlation of what it leaves from row to row."""


@cache
def followed(rho: float) -> Followed:
    """Of noise whose rows are correlated by rho^|lag|."""
    middle = savgol_coeffs(SMOOTHING, 2)
    rest = -middle
    rest[SMOOTHING // 2] += 1.0
    lag = np.subtract.outer(np.arange(SMOOTHING), np.arange(SMOOTHING))
    now, next_ = (float(rho) ** np.abs(lag - shift) for shift in (0, 1))
    left = float(rest @ now @ rest)
    return Followed(float(middle @ now @ middle), left, float(rest @ next_ @ rest) / left)


def _rest(cut: Stretches) -> Tensor:
    """[N, L, 6] measured less smoothed."""
    return torch.cat([cut.pose - cut.smooth_pose, cut.velocity - cut.smooth_velocity], -1)
