"""The law that the force of a simulator's axles follows."""

from typing import Any

import numpy as np
import torch
from scipy.optimize import least_squares

from buggy_rl.effects.measuring.drive import measured_drive
from buggy_rl.effects.measuring.holding import Make, next_velocity, period, throttle_for
from buggy_rl.effects.motion.base import Motion
from buggy_rl.vehicle import GRAVITY, VehicleDimensions, shift_velocity

CORNERING_SPEED = 2.5  # [m/s] at which the tyres are measured
SLIPS = 0.5  # [rad] the largest slip angle they are measured at
SLIDES = 9  # of the 20 slips that are measured: those at which tyres slide, from 0.3 rad on
PUSH = 0.4  # more throttle, for what driving wheels have left for the side
LEAST_GAIN = 0.3  # [m/s^2] by that throttle, or nothing is learnt from it
HIGHEST = 0.1  # [m] at which such a car leans
LEAST_USE = 0.2  # of its load with which any tyre pushes back that slides sideways
# D, C / D and c of a tyre: wide enough for a plain factor and for a slope that never bends.
TYRE_BOUNDS = ([0.05, 0.5, 0.5], [5.0, 100.0, 1.6])


def measured_tyres(
    make: Make, dimensions: VehicleDimensions, front_drive_share: float = 0.0
) -> dict[str, Any]:
    """What a simulator's axles give sideways: F = D sin(c atan(C slip / (c D))) of their load.

    The car slides straight ahead at an angle, so both axles have the same slip, under a throttle
    with which its tyres neither drive nor brake: it leans on neither axle.

    Args:
        make: Builds the simulator for a number of cars.
        dimensions: Of its car.
        front_drive_share: Share of its drive that its front axle passes.

    Returns:
        `friction` D [-], `stiffness` C [1/rad] and `shape` c [-], each of front and rear,
        `resistance` and `height`, as `TyreEffect` takes them.

    Raises:
        ValueError: The simulator's answer is not finite, or no tyre's.
    """
    d, dt = dimensions, period(make)
    share = np.array([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
    coasting = np.array(measured_drive(make)["coasting"])
    lost = float(coasting @ [1.0, CORNERING_SPEED])
    borne, height = _leaning(make, d, share, 1 - front_drive_share, lost)
    resistance = borne * coasting
    freely = throttle_for(make, CORNERING_SPEED, -float(resistance @ [1.0, CORNERING_SPEED]))
    slip, use, _ = _slid(make, d, freely)
    a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
    mobility = np.array([[1 + a * a / i, 1 - a * b / i], [1 - a * b / i, 1 + b * b / i]])
    settling = 0.5 * dt * GRAVITY / CORNERING_SPEED * mobility * share
    laws = [_law_of(slip, use[:, axle]) for axle in (0, 1)]
    for _ in range(3):  # what the slip settles within the step depends on the law
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
    }


def _slid(
    make: Make, d: VehicleDimensions, throttle: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Slips [20] [rad], each axle's force over its load at them [20, 2], acceleration [m/s^2]."""
    angle = torch.linspace(-SLIPS, SLIPS, 41)
    at_cg = torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)], -1)
    at_cg[:, :2] *= CORNERING_SPEED
    held = shift_velocity(at_cg, d.sensor_to_cg)
    after = shift_velocity(next_velocity(make, held, throttle), -d.sensor_to_cg)
    motion = Motion(torch.zeros_like(held), at_cg, after, torch.zeros(len(held), 2), period(make))
    ax, ay, yaw = motion.acceleration
    share = torch.tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
    spin = d.yaw_inertia / d.mass / d.wheelbase * yaw
    force = ay.unsqueeze(-1) + torch.stack([spin, -spin], -1) / share  # (41, 2) over load share
    force = 0.5 * (force.flip(0) - force)  # trim turns both sides alike
    slip, use = angle[21:], force[21:] / GRAVITY
    return slip.double().numpy(), use.double().numpy(), float(ax[-SLIDES:].mean())


def _leaning(
    make: Make, d: VehicleDimensions, share: np.ndarray, driven: float, lost: float
) -> tuple[float, float]:
    """What the tyres push against, and at what height, by what more throttle does to a slide.

    It leans the car backwards, which the front axle shows; and it takes from the side of the rear
    one what that gives lengthwise, of which the acceleration shows only a part.

    Args:
        make: Builds the simulator.
        d: Dimensions of the car.
        share: Of the weight [2], on the front axle and on the rear one.
        driven: Share of what tyres give lengthwise that the rear axle does.
        lost: By a coasting car [m/s^2].

    Returns:
        Share in 0..1 of what a coasting car loses that resists at its body, and the height [m] at
        which it leans; none of either where more throttle is hardly felt.
    """
    kept = throttle_for(make, CORNERING_SPEED, 0.0)
    _, use, gained = _slid(make, d, kept)
    _, pushed, more = _slid(make, d, kept + PUSH)
    if not more - gained > LEAST_GAIN or lost <= 0.0:
        return 0.0, 0.0
    front, rear = pushed[-SLIDES:].mean(0) / use[-SLIDES:].mean(0)
    rear /= 1 + (1 - front) * share[0] / share[1]
    circle = GRAVITY * share[1] * use[-SLIDES:, 1].mean()  # [m/s^2]
    shares = np.linspace(0.0, 1.0, 101)
    before, behind = (_left(driven * (gain + shares * lost) / circle) for gain in (gained, more))
    borne = float(shares[np.abs(behind / before - rear).argmin()])
    # The front axle's load over that at rest is 1 - e F, F what all tyres give lengthwise.
    first, last = gained + borne * lost, more + borne * lost
    e = (1 - front) / max(last - front * first, LEAST_GAIN)
    return borne, float(np.clip(e * d.wheelbase * GRAVITY * share[0], 0.0, HIGHEST))


def _left(use: np.ndarray | float) -> np.ndarray:
    """Share of a friction circle that is left for the side."""
    return np.sqrt(1 - np.square(np.clip(use, 0.0, 0.95)))


def _law(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    return friction * np.sin(shape * np.arctan(ratio / shape * slip))


def _slope(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    s = ratio / shape * slip
    return friction * ratio * np.cos(shape * np.arctan(s)).clip(0) / (1 + s * s)


def _law_of(slip: np.ndarray, use: np.ndarray) -> np.ndarray:
    """D, C / D and c of the law that comes closest.

    Raises:
        ValueError: What is seen is no tyre's.
    """
    first = [max(float(use.max()), 0.1), 8.0, 1.1]
    if use[-1] < LEAST_USE or first[0] > TYRE_BOUNDS[1][0]:
        raise ValueError(
            f"sliding sideways at {SLIPS:g} rad, an axle pushes back with {use[-1]:.2f} and at "
            f"most {use.max():.2f} of its load"
        )
    found = least_squares(lambda x: _law(slip, *x) - use, first, bounds=TYRE_BOUNDS)
    return found.x
