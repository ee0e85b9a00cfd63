"""How noisy the sensor is: standard deviations and the correlation of neighbouring rows.

A local parabola is fitted to what was measured; what it leaves tells the noise, corrected for the
share of the noise that the parabola itself follows.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from scipy.signal import savgol_coeffs
from torch import Tensor

from buggy_rl.estimation.segments import Segments, smoothing_rows

# Decays of AR(1) noise over a parabola that are told apart; noise that lasts over 2/3 of the
# parabola looks alike.
DECAYS = (math.inf, *(1.5 * np.geomspace(20, 1, 40)))
FAINT = 0.3  # [-] correlation below which the car's own motion may be the cause: taken for white
FLOOR = (1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3)  # [m, m, rad, m/s, m/s, rad/s] rounding of recordings
MAD_TO_SD = 1.4826  # [-] standard deviation over median absolute deviation of a Gaussian


def sensor_noise(segments: Segments) -> Tensor:
    """Standard deviation [6] of x, y, yaw, vx, vy, yaw_rate of a row.

    The median over the rows of what the parabola leaves: manoeuvres are outliers of it.
    """
    spread = MAD_TO_SD * _remainder(segments).flatten(0, 1).abs().median(0).values
    left = parabola_response(noise_correlation(segments), smoothing_rows(segments.dt)).left
    return torch.maximum(spread / left**0.5, torch.tensor(FLOOR))


def start_noise(segments: Segments) -> Tensor:
    """Standard deviation [6] of a smoothed row, from which a rollout starts."""
    kept = parabola_response(noise_correlation(segments), smoothing_rows(segments.dt)).kept
    return kept**0.5 * sensor_noise(segments)


def noise_correlation(segments: Segments) -> float:
    """AR(1) correlation rho of the noise from row to row, one for all channels; 0 for white noise.

    From how often neighbouring rows lie on the same side of their parabolas: of Gaussian noise
    P = 1/2 + asin(r) / pi. The median channel counts: in some the car moves faster than a parabola.
    """
    rest = _remainder(segments)
    same = ((rest[:, 1:] * rest[:, :-1]) > 0).double().mean((0, 1))  # (6,)
    seen = float(torch.sin(torch.pi * (same - 0.5)).median())
    rows = smoothing_rows(segments.dt)
    known = [math.exp(-decay / rows) for decay in DECAYS]
    rho = float(np.interp(seen, [parabola_response(r, rows).lag_one for r in known], known))
    return rho if rho >= FAINT else 0.0


@dataclass(frozen=True)
class ParabolaResponse:
    """What a parabola makes of noise of variance 1."""

    kept: float
    """Variance of the parabola's middle."""
    left: float
    """Variance of what it leaves."""
    lag_one: float
    """Correlation of what it leaves from row to row."""


@cache
def parabola_response(rho: float, rows: int) -> ParabolaResponse:
    """Of a parabola over so many rows, to noise whose rows are correlated by rho^|lag|."""
    middle = savgol_coeffs(rows, 2)
    rest = -middle
    rest[rows // 2] += 1.0
    lag = np.subtract.outer(np.arange(rows), np.arange(rows))
    now, next_ = (float(rho) ** np.abs(lag - shift) for shift in (0, 1))
    left = float(rest @ now @ rest)
    return ParabolaResponse(float(middle @ now @ middle), left, float(rest @ next_ @ rest) / left)


def _remainder(segments: Segments) -> Tensor:
    """[N, L, 6] measured minus smoothed."""
    smooth = torch.cat([segments.smooth_pose, segments.smooth_velocity], -1)
    return segments.measured - smooth
