"""Noise model: how residuals of a right simulator are distributed, and what they cost."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import torch
from scipy.signal import savgol_coeffs
from torch import Tensor

from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
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
    """Response of a parabola over so many rows to noise whose rows are correlated by rho^|lag|."""
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


HEAVY = 4.0  # [-] mean squared standardised residual at which a segment begins to count for less
FAR = 1e3  # [m, rad, m/s, rad/s] residual of a rollout that is not finite
STEEPEST = 10.0  # [-] change of a reading over a standard deviation of the start, at most


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Gaussian residuals of a segment, correlated by its start error, heavy-tailed over segments.

    e = A b + n with n ~ N(0, D) the sensor's noise and b ~ N(0, S) the start error, A its effect:
    e ~ N(0, C), C = D + A S A^T + E, with E what the simulator gets wrong on its baseline;
    W C W^T = I. The loss of a segment grows with the logarithm where a car spins:

    loss = h/2 log(1 + |W e|^2 / (phi h)),  h = HEAVY D, phi the dispersion.
    """

    whitening: Tensor
    """[N, D, D] float64 W, lower triangular; D = K * 6."""
    sd: Tensor
    """[6] standard deviation of a reading."""
    extra: Tensor | None = None
    """[D, D] E, or [N, D, D] with one of each segment."""
    about: Tensor | None = None
    """[N, K, 6] residuals about which the effect of a start error was computed."""

    @property
    def dimension(self) -> int:
        """Numbers of a segment (D)."""
        return self.whitening.shape[-1]

    @property
    def standing(self) -> Tensor | None:
        """[D, D] E, in the mean over segments: what other segments are expected to have."""
        own = self.extra
        return own.mean(0) if own is not None and own.dim() == 3 else own

    @property
    def of_sensor(self) -> "NoiseModel":
        """Noise model without what the simulator gets wrong on its baseline."""
        if self.extra is None:
            return self
        one = torch.eye(self.dimension, dtype=self.whitening.dtype).expand_as(self.whitening)
        root = torch.linalg.solve_triangular(self.whitening, one, upper=False)  # C = root root^T
        sensed = root @ root.mT - self.extra.to(root)
        lower = torch.linalg.cholesky(sensed)
        return replace(
            self, whitening=torch.linalg.solve_triangular(lower, one, upper=False), extra=None
        )

    def __getitem__(self, index: Tensor) -> "NoiseModel":
        about = None if self.about is None else self.about[index]
        extra = self.extra
        if extra is not None and extra.dim() == 3:
            extra = extra[index]
        return NoiseModel(self.whitening[index], self.sd, extra, about)

    def whiten(self, residuals: Tensor) -> Tensor:
        """W e [C, N, D] of residuals [C, N, K, 6]; what is not finite becomes large."""
        flat = residuals.flatten(2).double().nan_to_num(FAR, FAR, -FAR).clamp(-FAR, FAR)
        return torch.einsum("nij,cnj->cni", self.whitening, flat)

    def change_from(self, other: "NoiseModel") -> Tensor:
        """[N, D, D] W W_other^-1: re-whitens what the other one has whitened."""
        return torch.linalg.solve_triangular(other.whitening.mT, self.whitening.mT, upper=True).mT

    def loss(self, square: Tensor, dispersion: float = 1.0) -> Tensor:
        """[nats] of segments with |W e|^2 = `square` [*]."""
        heavy = HEAVY * self.dimension
        return 0.5 * heavy * torch.log1p(square / dispersion / heavy)

    def weight(self, square: Tensor, dispersion: float = 1.0) -> Tensor:
        """Derivative of twice the loss by the square, times the dispersion."""
        return 1 / (1 + square / dispersion / (HEAVY * self.dimension))


def noise_model(
    simulation: Simulation,
    segments: Segments,
    settings: ParameterSets = AS_GIVEN,
    extra: Tensor | None = None,
    noise_from: Segments | None = None,
) -> NoiseModel:
    """The noise model of segments, linearised about a simulator.

    Args:
        simulation: Of the simulator.
        segments: The segments.
        settings: One parameter set about which start errors are propagated.
        extra: [D, D] covariance of what the simulator gets wrong on its baseline, or [N, D, D]
            of what else is no error of it.
        noise_from: Segments that tell how noisy the sensor is; None for `segments` itself.
    """
    seen = segments if noise_from is None else noise_from
    slopes, about = start_sensitivity(simulation, segments, start_noise(seen), settings)
    sd = sensor_noise(seen)
    covariance = torch.diag(sd.double().square().repeat(about.shape[1])) + slopes @ slopes.mT
    if extra is not None:
        covariance = covariance + extra
    factor = torch.linalg.cholesky(covariance)
    eye = torch.eye(covariance.shape[-1], dtype=torch.float64).expand_as(covariance)
    return NoiseModel(torch.linalg.solve_triangular(factor, eye, upper=False), sd, extra, about)


DRAWS = 50  # readings drawn for each segment


def drawn_errors(
    simulation: Simulation,
    segments: Segments,
    settings: ParameterSets = AS_GIVEN,
    noise_from: Segments | None = None,
) -> Tensor:
    """Residuals [DRAWS N, K, 6] of a simulator without fault: of its sensor and of its start.

    Args:
        simulation: Of the simulator, by which errors of a start grow.
        segments: The segments.
        settings: One parameter set.
        noise_from: Segments that tell how noisy the sensor is; None for `segments` itself.
    """
    seen = segments if noise_from is None else noise_from
    slopes, about = start_sensitivity(simulation, segments, start_noise(seen), settings)
    chance = torch.Generator().manual_seed(0)
    start, sensor = (
        torch.randn(DRAWS, *of, generator=chance, dtype=torch.float64)
        for of in ((len(segments), 6, 1), about.shape)
    )
    grown = (slopes @ start).squeeze(-1).unflatten(2, about.shape[1:])
    return (grown + sensor * sensor_noise(seen).double()).flatten(0, 1)


def start_sensitivity(
    simulation: Simulation, segments: Segments, start_sd: Tensor, settings: ParameterSets = AS_GIVEN
) -> tuple[Tensor, Tensor]:
    """A sqrt(S) [N, D, 6], by one rollout a channel of the start; and the residuals [N, K, 6]."""
    error = torch.cat([torch.zeros(1, 6), torch.diag(start_sd)])
    residuals = simulation.residuals(segments, settings, error)  # (7, N, K, 6)
    moved = residuals[1:].double() - residuals[:1].double()
    slopes = moved.flatten(2).movedim(0, -1)  # (N, D, 6)
    return slopes.nan_to_num(0.0).clamp(-STEEPEST, STEEPEST), residuals[0]
