"""Fits the physical parameters a simulator declares to recordings, and says what these cannot tell.

Least squares on rollouts: a robust loss, a weak prior, start errors integrated out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import Similarity
from buggy_rl.estimation.body import body_of, bounded_by, implausible, top_speeds
from buggy_rl.estimation.evidence import jackknife
from buggy_rl.estimation.fit_result import AT_BOUND, Estimate, Fit, position_errors
from buggy_rl.estimation.noise_model import MAD_TO_SD, start_sensitivity
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import WARM_UP, Segments, cut_segments
from buggy_rl.recordings import Recording
from buggy_rl.recordings.recording import refuse_another_rest

WIDE = 0.5  # [parameter ranges] an interval of this width determines nothing
CORRELATED = 0.95  # [-] two parameters with errors correlated like this trade against each other,
TRADED = 0.1  # [parameter ranges] which matters where the interval is wider than this
CHANNEL_SCALE = {  # residual that weighs as one
    "position": 0.02,  # [m]
    "yaw": 0.03,  # [rad]
    "vx": 0.1,  # [m/s]
    "vy": 0.1,  # [m/s]
    "yaw_rate": 0.3,  # [rad/s]
}
SCALES = [CHANNEL_SCALE["position"], *CHANNEL_SCALE.values()]  # of x, y, yaw, vx, vy, yaw_rate
PRIOR_SD = 0.5  # [parameter ranges] weak: keeps what the recordings do not show where it was
STEP = 2e-3  # [parameter ranges] finite difference
INSIDE = 1e-3  # [parameter ranges] distance from a bound at which a fit starts
LEAST_NOISE = 1e-4  # [m/s, rad/s] standard deviation of a start velocity


@dataclass(frozen=True)
class FitConfig:
    """How a fit is made."""

    parameters: list[str] = field(default_factory=list)
    """Names of the parameters to fit; empty for all that the simulator declares."""
    fixed: list[str] = field(default_factory=lambda: ["mass"])
    """Parameters left as they are, unless named above: weigh the car, drives cannot tell mass."""
    horizon: float = 1.0
    """Length of a window [s]."""
    windows: int = 150
    """Most windows to fit on, spread evenly over the drives."""
    iterations: int = 12
    """Most iterations of the first pass; the second takes at most half of it, but 3 at least."""
    every: int = 10
    """Rows between the compared instants."""
    smoothing: int = 21
    """Rows of the local parabola that smooths the velocities the first pass starts from; what it
    takes away is also the estimate of the sensor's noise."""


def second_pass(config: FitConfig) -> int:
    """Most iterations of the second pass."""
    return max(3, config.iterations // 2)


@dataclass(frozen=True, eq=False)
class RolloutResiduals:
    """Standardised residuals as a function of parameters, each range scaled to [0, 1].

    r = W e / s with the channels' scales s, and (p - p_0) / PRIOR_SD for each parameter.
    """

    simulation: Simulation
    segments: Segments
    """Rollouts start from their smoothed motion."""
    parameters: Sequence[Parameter]
    whitening: Tensor | None = None
    """[N, D, D] W, once start errors are integrated out."""
    scales: Tensor = field(default_factory=lambda: torch.tensor(SCALES))
    """[6] s, of x, y, yaw, vx, vy, yaw_rate."""

    @property
    def prior(self) -> NDArray:
        """The declared values [P]."""
        return np.array([(p.value - p.lower) / (p.upper - p.lower) for p in self.parameters])

    def value(self, scaled: NDArray) -> NDArray:
        """Residuals [M] at scaled parameters [P]."""
        return np.concatenate([self._residuals(scaled[None])[0], (scaled - self.prior) / PRIOR_SD])

    def jacobian(self, scaled: NDArray) -> NDArray:
        """Finite differences [M, P], inward at a bound; all columns in one batch."""
        steps = np.where(scaled < 0.5, STEP, -STEP)
        residuals = self._residuals(np.stack([scaled, *(scaled + np.diag(steps))]))  # (1 + P, M)
        columns = ((residuals[1:] - residuals[0]) / steps[:, None]).T
        return np.concatenate([columns, np.eye(len(scaled)) / PRIOR_SD])

    def covariance(self, scaled: NDArray, group: Tensor) -> NDArray:
        """Covariance [P, P] of the solution by leaving out one block [N] at a time."""
        count, width = len(self.segments), len(scaled)
        residual, jacobian = self.value(scaled), self.jacobian(scaled)
        weight = 1 / np.sqrt(1 + residual**2)  # derivative of soft_l1
        parts = (jacobian, jacobian * weight[:, None], (weight * residual)[:, None])
        rows, weighted, scores = (
            torch.from_numpy(x[:-width].reshape(count, -1, x.shape[1])) for x in parts
        )
        curvature = torch.einsum("ndp,ndq->npq", rows, weighted)
        score = torch.einsum("ndp,ndo->np", rows, scores)
        information = torch.full((width,), PRIOR_SD**-2, dtype=torch.float64)
        precision = information * torch.from_numpy(weight[-width:])
        return jackknife(curvature, score, precision, group, information)[1].numpy()

    def with_free_starts(self, scaled: NDArray) -> "RolloutResiduals":
        """Residuals of rollouts that start as measured, each start off by an unknown noise.

        To first order the residual of a segment is e + A b, b ~ N(0, S) its start error; b
        integrated out leaves the covariance s^2 I + A S A^T, whitened here. s is the scatter of
        the residuals at `scaled`, S the sensor's velocity noise.
        """
        segments = self.segments
        scatter = MAD_TO_SD * float(np.median(np.abs(self._residuals(scaled[None]))))
        noise = torch.std(segments.velocity - segments.smooth_velocity, (0, 1))  # (3,)
        start_sd = torch.cat([torch.zeros(3), noise.clamp_min(LEAST_NOISE)])
        segments = replace(segments, smooth_velocity=segments.velocity)
        settings = scaled_settings(self.parameters, scaled[None])
        slopes, about = start_sensitivity(self.simulation, segments, start_sd, settings)
        slopes = slopes / self.scales.double().repeat(about.shape[1]).unsqueeze(-1)
        eye = torch.eye(slopes.shape[1], dtype=torch.float64)
        covariance = max(scatter, 1e-3) ** 2 * eye + slopes @ slopes.mT
        whitening = torch.linalg.inv(torch.linalg.cholesky(covariance))
        return replace(self, segments=segments, whitening=whitening)

    def _residuals(self, scaled: NDArray) -> NDArray:
        """Residuals [C, M] of C sets of scaled parameters, in one batch."""
        settings = scaled_settings(self.parameters, scaled)
        residuals = self.simulation.residuals(self.segments, settings)
        flat = (residuals / self.scales).flatten(2).double()  # (C, N, D)
        if self.whitening is not None:
            flat = torch.einsum("nij,cnj->cni", self.whitening, flat)
        if not bool(flat.isfinite().all()):
            raise FloatingPointError(
                "the simulator returned values that are not finite: narrow its parameters' ranges"
            )
        return flat.flatten(1).numpy()


def scaled_settings(parameters: Sequence[Parameter], scaled: NDArray) -> ParameterSets:
    """C sets of parameters [C, P], each range scaled to [0, 1]."""
    lower = np.array([p.lower for p in parameters])
    width = np.array([p.upper - p.lower for p in parameters])
    values = torch.as_tensor(lower + scaled * width, dtype=torch.float32)
    return ParameterSets(parameters={p.name: values[:, i] for i, p in enumerate(parameters)})


def residual_scales(simulator: EnvBase) -> Tensor:
    """[6] residuals that weigh as one: those of the buggy, scaled to the simulator's car."""
    scale = getattr(simulator, "similarity", Similarity())
    units = ("m", "m", "rad", "m/s", "m/s", "rad/s")
    return torch.tensor([s * scale.of(unit) for s, unit in zip(SCALES, units, strict=True)])


def least_squares_fit(
    make: Callable[[int], EnvBase],
    recordings: Sequence[Recording],
    config: FitConfig,
    on_iteration: Callable[[dict[str, float]], None] = lambda _: None,
) -> Fit:
    """Least squares on rollouts, with a column of the Jacobian a part of the simulator's batch.

    A first pass starts its rollouts from smoothed velocities. A second starts from those measured
    and lets each segment's start be off by the sensor's noise: noise in the start would pull
    parameters away from the truth. Intervals leave out one segment at a time.

    Args:
        make: Builds the simulator for a number of environments; it has `declared` parameters and
            `with_parameters`.
        recordings: What it is fitted to.
        config: How.
        on_iteration: Told `iteration` and `cost` after each step of the solver.

    Raises:
        KeyError: A name in the config is not a parameter of the simulator.
        ValueError: The simulator declares none or takes another command than the recordings have,
            or a rollout holds no instant to compare.
        FloatingPointError: The simulator does not return finite rollouts.
    """
    refuse_another_rest(recordings, make(1))
    segments = fit_segments(recordings, config)
    simulation = Simulation(make, every=config.every)
    chosen, scales = _chosen(make(1), config), residual_scales(make(1))
    residuals = RolloutResiduals(simulation, segments, chosen, scales=scales)
    iteration = 0

    def report(intermediate_result) -> None:
        nonlocal iteration
        iteration += 1
        on_iteration({"iteration": iteration, "cost": float(intermediate_result.cost)})

    scaled = _solved(residuals, residuals.prior, config.iterations, report).x
    residuals = residuals.with_free_starts(scaled)
    solution = _solved(residuals, scaled, second_pass(config), report)
    scaled = solution.x
    group = segments.length_blocks()
    covariance = residuals.covariance(scaled, group)
    spread = float(student_t.ppf(0.975, max(1, len(group.unique()) - 1)))
    estimates = _estimates(residuals.parameters, scaled, covariance, spread)
    estimates = plausible(estimates, make(1))
    settings = scaled_settings(residuals.parameters, scaled[None])
    errors = position_errors(simulation, segments, settings)
    return Fit(estimates, solution.status > 0, *errors)


def plausible(estimates: Sequence[Estimate], simulator: EnvBase) -> list[Estimate]:
    """Estimates with a warning more where a real car has no such value."""
    declared: dict[str, Parameter] = getattr(simulator, "declared", {})
    values = {name: p.value for name, p in declared.items()}
    values |= {e.parameter.name: e.value for e in estimates}
    odd = implausible(values, body_of(simulator), top_speeds(simulator, values))
    return [
        replace(e, warnings=(*e.warnings, odd[e.parameter.name])) if e.parameter.name in odd else e
        for e in estimates
    ]


def fit_segments(recordings: Sequence[Recording], config: FitConfig) -> Segments:
    """Segments that follow one another, started from measured poses and smoothed velocities."""
    dt = recordings[0].dt
    if round(config.horizon / dt) < config.every:
        raise ValueError(
            f"segments of {round(config.horizon / dt)} rows hold no instant to compare every "
            f"{config.every} rows: lengthen fit.horizon or lower fit.every"
        )
    stride = WARM_UP + config.horizon + dt
    segments = cut_segments(recordings, config.horizon, stride, config.smoothing)
    return replace(segments, smooth_pose=segments.pose).spread(config.windows)


def _chosen(simulator: EnvBase, config: FitConfig) -> list[Parameter]:
    declared: dict[str, Parameter] = getattr(simulator, "declared", {})
    unknown = sorted(set(config.parameters) - set(declared))
    if unknown:
        raise KeyError(
            f"the simulator has no parameter {', '.join(unknown)}; "
            f"available: {', '.join(sorted(declared)) or 'none'}"
        )
    names = config.parameters or [name for name in declared if name not in config.fixed]
    if not names:
        raise ValueError("the simulator declares no parameters to fit")
    body = body_of(simulator)
    return [bounded_by(body, declared[name]) for name in names]


def _solved(residuals: RolloutResiduals, start: NDArray, iterations: int, report):
    return least_squares(
        residuals.value,
        start.clip(INSIDE, 1 - INSIDE),
        residuals.jacobian,  # type: ignore[arg-type]  # a callable is allowed
        bounds=(0.0, 1.0),
        loss="soft_l1",
        x_scale=0.1,
        ftol=1e-6,
        xtol=1e-6,
        max_nfev=iterations,
        callback=report,
    )


def _estimates(
    chosen: Sequence[Parameter], scaled: np.ndarray, covariance: np.ndarray, spread: float
) -> list[Estimate]:
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    estimates = []
    for i, parameter in enumerate(chosen):
        width = parameter.upper - parameter.lower
        low, high = (np.array([-spread, spread]) * sd[i] + scaled[i]).clip(0, 1)
        warnings = []
        if high - low > WIDE:
            warnings.append("these drives do not determine it")
        if scaled[i] < 0.01 or scaled[i] > 0.99:
            warnings.append(AT_BOUND)
        for j, other in enumerate(chosen):
            if j != i and abs(correlation[i, j]) > CORRELATED and high - low > TRADED:
                warnings.append(f"these drives cannot tell it from {other.name}")
        value, low, high = (float(parameter.lower + x * width) for x in (scaled[i], low, high))
        estimates.append(Estimate(parameter, value, low, high, tuple(warnings)))
    return estimates
