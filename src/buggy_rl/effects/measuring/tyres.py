"""Identification of the tyre law of a simulator's axles."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY_REST
from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions, shift_velocity
from buggy_rl.effects.measuring.drive import (
    Make,
    ThrottleSweep,
    measured_drive,
    next_velocity,
    period,
    resting,
    throttle_sweeps,
)
from buggy_rl.effects.motion.base import Motion

CORNERING_SPEED = 2.5  # [m/s] speed of the experiment; the buggy's indoor drives reach 3.5 m/s
SLIPS = 0.5  # [rad] largest slip angle; chosen: beyond the peak of every preset
SLIDES = 9  # of the 20 slip angles: the largest ones, from 0.3 rad on, at which tyres slide
PUSH = 0.4  # [-] second throttle above the first, to see the friction ellipse; chosen
LEAST_GAIN = 0.3  # [m/s^2] least effect of that throttle for which it is evaluated; chosen
HIGHEST = 0.1  # [m] largest height h of the longitudinal forces: over twice that of the buggy's cg
ELLIPSE = 0.2  # [-] of what a friction ellipse would take; plants show 0.47 and more, others 0.01
LEAST_LOSS = 0.01  # [-] of the rear side force, below which an ellipse does not show; chosen
LEAST_USE = 0.2  # [-] least side force over load of a tyre at 0.5 rad
# D, C / D and c: D of 5 holds a tyre that stays linear up to the largest slip angle.
TYRE_BOUNDS = ([0.05, 0.5, 0.5], [5.0, 100.0, 1.6])


def measured_tyres(
    make: Make,
    dimensions: VehicleDimensions,
    front_drive_share: float = 0.0,
    coasting: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Fits F = N D sin(c atan(C alpha / (c D))) to the side forces of both axles.

    The car slides straight ahead at a sideslip angle, so both axles have that slip angle, at a
    throttle at which its tyres neither drive nor brake, so no load is transferred.

    Args:
        make: Builds the simulator for a number of environments.
        dimensions: Of its car.
        front_drive_share: Share of its drive at the front axle.
        coasting: As `measured_drive` finds it; None to measure it.

    Returns:
        `friction` D [-], `stiffness` C [1/rad] and `shape` c [-], each of front and rear,
        `resistance`, `height` and `combined_slip`, as `TyreEffect` takes them.

    Raises:
        ValueError: A velocity of the simulator is not finite, or its side force is no tyre's.
    """
    d, dt = dimensions, period(make)
    share = np.array([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
    rolling = np.array(coasting or measured_drive(make)["coasting"])
    lost = float(rolling @ [1.0, CORNERING_SPEED])
    [sweep] = throttle_sweeps(make, [CORNERING_SPEED])
    driven = 1 - front_drive_share
    borne, height, combined = _drive_in_a_slide(make, d, sweep, share, driven, lost)
    resistance = borne * rolling
    freely = sweep.throttle_for(-float(resistance @ [1.0, CORNERING_SPEED]))
    [(slip, use, _)] = _sliding(make, d, [freely])
    a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
    mobility = np.array([[1 + a * a / i, 1 - a * b / i], [1 - a * b / i, 1 + b * b / i]])
    settling = 0.5 * dt * GRAVITY / CORNERING_SPEED * mobility * share
    laws = [_law_of(slip, use[:, axle]) for axle in (0, 1)]
    for _ in range(3):  # the mean force over the step depends on the law: a fixed point
        slopes = np.stack([_slope(slip, *laws[axle]) for axle in (0, 1)], -1)  # (20, 2)
        start = use + slopes * (use @ settling.T)
        laws = [_law_of(slip, start[:, axle]) for axle in (0, 1)]
    friction, ratio, shape = np.array(laws).T
    return {
        "friction": np.round(friction, 4).tolist(),
        "stiffness": np.round(friction * ratio, 4).tolist(),
        "shape": np.round(shape, 4).tolist(),
        "resistance": np.round(resistance, 4).tolist(),
        "height": round(height, 4),
        "combined_slip": combined,
    }


def _sliding(
    make: Make, d: VehicleDimensions, throttles: Sequence[float]
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Slides at throttles, all in one batch.

    Returns:
        For each: slip angles [20] [rad], side force over load of the axles [20, 2], acceleration
        [m/s^2].
    """
    angle = torch.linspace(-SLIPS, SLIPS, 41)
    at_cg = torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)], -1)
    at_cg[:, :2] *= CORNERING_SPEED
    count = len(throttles)
    held = shift_velocity(at_cg, d.sensor_to_cg).repeat(count, 1)
    drive = torch.tensor(throttles).repeat_interleave(len(angle))
    after = shift_velocity(next_velocity(make, held, drive), -d.sensor_to_cg)
    return [_side_forces(d, angle, at_cg, own, period(make)) for own in after.chunk(count)]


def _side_forces(
    d: VehicleDimensions, angle: Tensor, at_cg: Tensor, after: Tensor, dt: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Side forces of one slide, velocities [41, 3] of the centre of gravity around a step."""
    nothing = torch.zeros_like(at_cg)
    motion = Motion(nothing, at_cg, after, nothing[:, :2], dt)
    ax, ay, yaw = motion.acceleration
    share = torch.tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
    spin = d.yaw_inertia / d.mass / d.wheelbase * yaw
    force = ay.unsqueeze(-1) + torch.stack([spin, -spin], -1) / share  # (41, 2) over the load share
    force = 0.5 * (force.flip(0) - force)  # a steering trim turns both sides alike
    slip, use = angle[21:], force[21:] / GRAVITY
    return slip.double().numpy(), use.double().numpy(), float(ax[-SLIDES:].mean())


def _drive_in_a_slide(
    make: Make,
    d: VehicleDimensions,
    sweep: ThrottleSweep,
    share: np.ndarray,
    driven: float,
    lost: float,
) -> tuple[float, float, float]:
    """What a second throttle in the slide shows: resistance at the body, h, and combined slip.

    More throttle transfers load to the rear, which the front axle's side force shows, and by the
    friction ellipse reduces the rear axle's. The drive that does so is the acceleration plus the
    resistance at the body; resistance inside motor and gear loads no tyre.

    Args:
        make: Builds the simulator.
        d: Dimensions of the car.
        sweep: Its throttle at `CORNERING_SPEED`.
        share: Of the weight [2] on front and rear axle.
        driven: Share of the drive at the rear axle.
        lost: Deceleration of the coasting car [m/s^2].

    Returns:
        Share in 0..1 of the coasting deceleration that acts at the body, h [m], and 1, or 0 for a
        simulator whose drive takes nothing from the side force; 0, 0 and 1 where the second
        throttle has no effect.
    """
    kept = sweep.throttle_for(0.0)
    push = PUSH if resting(make) == ONE_WAY_REST else 0.5 * PUSH  # the same drive
    (_, use, gained), (_, pushed, more) = _sliding(make, d, [kept, kept + push])
    if not more - gained > LEAST_GAIN or lost <= 0.0:
        return 0.0, 0.0, 1.0
    front, rear = pushed[-SLIDES:].mean(0) / use[-SLIDES:].mean(0)
    rear /= 1 + (1 - front) * share[0] / share[1]
    circle = GRAVITY * share[1] * use[-SLIDES:, 1].mean()  # [m/s^2]
    shares = np.linspace(0.0, 1.0, 101)
    before, behind = (_left(driven * (gain + shares * lost) / circle) for gain in (gained, more))
    borne = float(shares[np.abs(behind / before - rear).argmin()])
    taken = 1 - float(behind[0] / before[0])  # by an ellipse, were there no resistance
    seen = taken < LEAST_LOSS or 1 - rear > ELLIPSE * taken
    # The front axle's load over that at rest is 1 - e F, F the longitudinal force of all tyres.
    first, last = gained + borne * lost, more + borne * lost
    e = (1 - front) / max(last - front * first, LEAST_GAIN)
    height = float(np.clip(e * d.wheelbase * GRAVITY * share[0], 0.0, HIGHEST))
    return (borne, height, 1.0) if seen else (0.0, height, 0.0)


def _left(use: np.ndarray | float) -> np.ndarray:
    """Share of the friction that is left for the side force."""
    return np.sqrt(1 - np.square(np.clip(use, 0.0, 0.95)))


def _law(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    return friction * np.sin(shape * np.arctan(ratio / shape * slip))


def _slope(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    s = ratio / shape * slip
    return friction * ratio * np.cos(shape * np.arctan(s)).clip(0) / (1 + s * s)


def _law_of(slip: np.ndarray, use: np.ndarray) -> np.ndarray:
    """D, C / D and c of the law, by least squares.

    Raises:
        ValueError: The side force is no tyre's.
    """
    first = [max(float(use.max()), 0.1), 8.0, 1.1]
    if use[-1] < LEAST_USE or first[0] > TYRE_BOUNDS[1][0]:
        raise ValueError(
            f"at a slip angle of {SLIPS:g} rad the side force of an axle is {use[-1]:.2f} and at "
            f"most {use.max():.2f} of its load: no tyre's"
        )
    found = least_squares(lambda x: _law(slip, *x) - use, first, bounds=TYRE_BOUNDS)
    return found.x
