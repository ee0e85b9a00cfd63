"""Identification of axle positions, centre of gravity and yaw inertia of a black-box simulator.

Axle forces are read off accelerations by the balance of lateral force and yaw moment, so these
numbers must be the simulator's own. While it rolls straight ahead with (vx, vy, r) imposed, the
force of an axle depends on the lateral velocity of that axle alone:

    y_f = vy + x_f r,   y_r = vy - x_r r,
    (dvy/dt + vx r, dr/dt) = J (1, x_f) F_f(y_f / vx) + J (1, -x_r) F_r(y_r / vx),
    J = 1 / i [[i + c^2, -c], [-c, 1]],

with forces over mass, x_f and x_r [m] the distances of the axles from the reference point, c [m]
that of the centre of gravity ahead of it and i [m^2] the yaw inertia over mass. Tyres saturate, so
the directions in (vy, r) along which the two forces change can be told apart; a tyre that stays
linear leaves the numbers undetermined, which the fit's covariance shows.

Source: Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., sec. 2.3 (single-track car).
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.effects.measuring.drive import Make, next_velocity, period, throttle_sweeps

SPEEDS = (2.5, 4.0)  # [m/s] of the experiment; chosen within what a 1:10 car drives
SLIPS = (0.05, 0.12, 0.23, 0.4)  # [rad] slip angles of both axles, both signs; chosen
SUBSTEPS = 4  # of the fitted car in a control period; 8 change the single track's by 0.5 %
LARGE = 0.3  # [m/s^2] residual beyond which the loss grows linearly; chosen
LEAST = (0.01, 0.01, -0.3, 3e-4)  # [m], [m], [m], [m^2] bounds of x_f, x_r, c, i
MOST = (0.6, 0.6, 0.3, 0.2)
TYRE = (0.85, 7.0, 1.3)  # D, C [1/rad], c of the start, forces over load
TYRE_BOUNDS = ((0.05, 0.5, 0.5), (5.0, 100.0, 1.9))
CERTAIN = 0.1  # [-] largest standard error of a length over the wheelbase, of i over itself; chosen
SATURATED = 0.85  # [-] largest force at the largest slip over that of a linear tyre; chosen
UNEXPLAINED = 0.3  # [-] largest rms residual over rms acceleration; a kinematic car leaves 0.47


@dataclass(frozen=True, eq=False)
class Steps:
    """Single steps of a simulator from imposed velocities, without its left-right asymmetry."""

    held: NDArray
    """[n, 3] vx, vy [m/s], r [rad/s]."""
    after: NDArray
    """[n, 3] the same a step later."""
    dt: float
    """[s]"""


def measured_dimensions(make: Make, typical: VehicleDimensions) -> VehicleDimensions:
    """Fits axles, centre of gravity and yaw inertia to single steps of a simulator.

    Args:
        make: Builds the simulator for a number of environments.
        typical: Where the fit starts; what no step shows, such as the mass, is kept.

    Raises:
        ValueError: A velocity of the simulator is not finite, its steps are not those of a car on
            two axles, or they do not determine the numbers.
    """
    steps = _steps(make, typical)
    found = _fit(steps, typical)
    _refuse(found, steps)
    x_front, x_rear, cg, inertia = found.x[:4].tolist()
    return replace(
        typical,
        wheelbase=round(x_front + x_rear, 5),
        cg_to_front_axle=round(x_front - cg, 5),
        sensor_to_cg=round(-cg, 5),
        yaw_inertia=round(inertia * typical.mass, 7),
    )


def _steps(make: Make, typical: VehicleDimensions) -> Steps:
    grids = [_grid(speed, typical) for speed in SPEEDS]
    held, mirror = torch.cat(grids), torch.tensor([1.0, -1.0, -1.0])
    freely = torch.tensor([sweep.throttle_for(0.0) for sweep in throttle_sweeps(make, SPEEDS)])
    throttle = freely.repeat_interleave(len(grids[0])).repeat(2)
    after = next_velocity(make, torch.cat([held, mirror * held]), throttle).view(2, -1, 3)
    mean = 0.5 * (after[0] + mirror * after[1])  # a steering trim turns both alike
    return Steps(held.double().numpy(), mean.double().numpy(), period(make))


def _grid(speed: float, typical: VehicleDimensions) -> torch.Tensor:
    """Velocities [n, 3] at which the axles of a typical car have all pairs of slip angles."""
    ahead = typical.cg_to_front_axle - typical.sensor_to_cg
    both = torch.tensor([*(-s for s in SLIPS), 0.0, *SLIPS])
    front, rear = torch.cartesian_prod(both, torch.tensor([0.0, *SLIPS])).unbind(-1)
    yaw_rate = speed * (front - rear) / typical.wheelbase
    vy = speed * front - ahead * yaw_rate
    return torch.stack([torch.full_like(vy, speed), vy, yaw_rate], -1)


def _fit(steps: Steps, typical: VehicleDimensions) -> OptimizeResult:
    scale = np.array([1.0, 0.5 * typical.wheelbase]) / steps.dt  # yaw as acceleration at an axle

    def residual(numbers: NDArray) -> NDArray:
        return ((_moved(numbers, steps) - steps.after[:, 1:]) * scale).ravel()

    body = [
        typical.cg_to_front_axle - typical.sensor_to_cg,
        typical.cg_to_rear_axle + typical.sensor_to_cg,
        -typical.sensor_to_cg,
        typical.yaw_inertia / typical.mass,
    ]
    start = np.array([*body, *_tyres(TYRE)])
    bounds = tuple(
        np.array([*ends, *_tyres(tyre)])
        for ends, tyre in zip((LEAST, MOST), TYRE_BOUNDS, strict=True)
    )
    return least_squares(
        residual,
        np.clip(start, *bounds),
        bounds=bounds,
        loss="soft_l1",
        f_scale=LARGE,
        x_scale=np.maximum(np.abs(start), 0.01),
    )


def _tyres(law: tuple[float, float, float]) -> list[float]:
    """Numbers of both axles' laws, half of the weight on each."""
    friction, stiffness, shape = law
    return [0.5 * GRAVITY * friction, 0.5 * GRAVITY * stiffness, shape] * 2


def _moved(numbers: NDArray, steps: Steps) -> NDArray:
    """State vy, r [n, 2] of the fitted car a step later, by the midpoint method."""
    x_front, x_rear, cg, inertia = numbers[:4]
    mobility = np.array([[inertia + cg * cg, -cg], [-cg, 1.0]]) / inertia
    arms = np.array([[1.0, x_front], [1.0, -x_rear]])
    per_force = arms @ mobility  # (2, 2) accelerations by a unit force of each axle
    vx, growth = steps.held[:, 0], steps.after[:, 0] - steps.held[:, 0]
    state, h = steps.held[:, 1:].copy(), steps.dt / SUBSTEPS

    def rate(state: NDArray, done: float) -> NDArray:
        speed = vx + done * growth
        slip = np.arctan(state @ arms.T / speed[:, None])  # (n, 2)
        force = np.stack([_force(slip[:, k], numbers[4 + 3 * k : 7 + 3 * k]) for k in (0, 1)], -1)
        turning = np.stack([speed * state[:, 1], np.zeros_like(speed)], -1)
        return force @ per_force - turning

    for k in range(SUBSTEPS):
        middle = state + 0.5 * h * rate(state, k / SUBSTEPS)
        state = state + h * rate(middle, (k + 0.5) / SUBSTEPS)
    return state


def _force(slip: NDArray, law: NDArray) -> NDArray:
    """Lateral force over mass at slip angles [n], magic formula without curvature factor."""
    peak, slope, shape = law
    return -peak * np.sin(shape * np.arctan(slope / (shape * peak) * slip))


def _refuse(found: OptimizeResult, steps: Steps) -> None:
    """Refuses a fit that explains little, or that other numbers would do as well."""
    felt = (steps.after - steps.held)[:, 1:]
    felt[:, 0] += steps.dt * steps.held[:, 0] * steps.held[:, 2]  # of a turning frame
    left = _moved(found.x, steps) - steps.after[:, 1:]
    share = float(np.sqrt(((left**2).sum(0) / np.maximum((felt**2).sum(0), 1e-12)).max()))
    if share > UNEXPLAINED:
        raise ValueError(
            f"a car on two axles leaves {share:.0%} of its lateral or yaw acceleration "
            f"unexplained, more than {UNEXPLAINED:.0%}"
        )
    variance = (found.fun**2).mean() * np.linalg.pinv(found.jac.T @ found.jac).diagonal()[:4]
    wheelbase = found.x[0] + found.x[1]
    worst = float((np.sqrt(variance) / [wheelbase, wheelbase, wheelbase, found.x[3]]).max())
    if worst > CERTAIN or max(_held_linearly(found.x[k : k + 3]) for k in (4, 7)) > SATURATED:
        raise ValueError(
            f"its tyres do not saturate within {SLIPS[-1]:g} rad of slip angle, so the positions "
            "of its axles cannot be told apart"
        )


def _held_linearly(law: NDArray) -> float:
    """Force of an axle at the largest slip angle over that of a tyre that stays linear."""
    slip = np.array([SLIPS[-1]])
    return float(-_force(slip, law)[0] / (law[1] * slip[0]))
