"""Fits the physical parameters a simulator declares to drives, and says what they cannot tell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.optimize import least_squares
from scipy.stats import t as student_t
from tensordict import TensorDictBase

from buggy_rl.identification.residuals import RolloutResiduals, Simulator
from buggy_rl.parameters import Parameter

WIDE = 0.5  # an interval that covers this share of the range determines nothing
CORRELATED = 0.95  # two parameters whose errors go together like this trade against each other,
TRADED = 0.1  # which matters where the interval covers this share of the range


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


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter."""

    parameter: Parameter
    """As declared, with the value the fit started from."""
    value: float
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end."""
    warnings: tuple[str, ...] = ()
    """What the drives cannot tell about it, in plain words."""


def second_pass(config: FitConfig) -> int:
    """Most iterations of the second pass."""
    return max(3, config.iterations // 2)


def fit(
    simulator: Simulator,
    windows: TensorDictBase,
    smooth_velocity: torch.Tensor,
    groups: torch.Tensor,
    config: FitConfig,
    on_iteration: Callable[[dict[str, float]], None] = lambda _: None,
) -> list[Estimate]:
    """Least squares on rollouts, with a column of the Jacobian a row of the simulator's batch.

    A first pass starts its rollouts from smoothed velocities. A second starts from those measured
    and lets each window's start be off by the sensor's noise (see `RolloutResiduals.free_start`):
    noise in the start would pull parameters away from the truth. Intervals are cluster-robust:
    neighbouring windows count once.

    Args:
        simulator: Has `declared` parameters and takes them by `with_parameters`.
        windows: [N, WARM_UP + horizon + 1] of drives.
        smooth_velocity: [N, WARM_UP + horizon + 1, 3] their velocities without noise and lag.
        groups: [N] int, windows with the same number are not independent.
        config: How.
        on_iteration: Told `iteration` and `cost` after each step of the solver.

    Raises:
        KeyError: A name in the config is not a parameter of the simulator.
        FloatingPointError: The simulator does not return finite rollouts.
    """
    declared = [name for name in simulator.declared if name not in config.fixed]
    names = config.parameters or declared
    if not names:
        raise ValueError("the simulator declares no parameters to fit")
    residuals = RolloutResiduals(simulator, names, windows, smooth_velocity, config.every)
    iteration = 0

    def report(intermediate_result) -> None:
        nonlocal iteration
        iteration += 1
        on_iteration({"iteration": iteration, "cost": float(intermediate_result.cost)})

    def solve(start: np.ndarray, iterations: int) -> np.ndarray:
        return least_squares(
            residuals.value,
            start.clip(1e-3, 1 - 1e-3),
            residuals.jacobian,  # type: ignore[arg-type]  # a callable is allowed
            bounds=(0.0, 1.0),
            loss="soft_l1",
            x_scale=0.1,
            ftol=1e-6,
            xtol=1e-6,
            max_nfev=iterations,
            callback=report,
        ).x

    place = solve(residuals.prior, config.iterations)
    residuals.free_start(place)
    place = solve(place, second_pass(config))
    covariance = residuals.covariance(place, groups.numpy())
    spread = float(student_t.ppf(0.975, max(1, len(np.unique(groups)) - 1)))
    return _estimates(residuals.chosen, place, covariance, spread)


def _estimates(
    chosen: Sequence[Parameter], place: np.ndarray, covariance: np.ndarray, spread: float
) -> list[Estimate]:
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    estimates = []
    for i, parameter in enumerate(chosen):
        width = parameter.upper - parameter.lower
        low, high = (np.array([-spread, spread]) * sd[i] + place[i]).clip(0, 1)
        warnings = []
        if high - low > WIDE:
            warnings.append("these drives do not determine it")
        if place[i] < 0.01 or place[i] > 0.99:
            warnings.append("it lies at the edge of its range")
        for j, other in enumerate(chosen):
            if j != i and abs(correlation[i, j]) > CORRELATED and high - low > TRADED:
                warnings.append(f"these drives cannot tell it from {other.name}")
        value, low, high = (float(parameter.lower + x * width) for x in (place[i], low, high))
        estimates.append(Estimate(parameter, value, low, high, tuple(warnings)))
    return estimates


def as_simulator(engine: str, estimates: Sequence[Estimate], options: dict) -> dict:
    """A fit as the content of a simulator file that `make_engine` reads."""
    return {
        "engine": engine,
        "options": options,
        "parameters": {e.parameter.name: round(e.value, 6) for e in estimates},
        "_fit": {
            e.parameter.name: {
                "low": round(e.low, 6),
                "high": round(e.high, 6),
                "unit": e.parameter.unit,
                "started_from": e.parameter.value,
                "warnings": list(e.warnings),
            }
            for e in estimates
        },
    }
