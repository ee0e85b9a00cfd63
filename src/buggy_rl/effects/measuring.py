"""What some effects must know of the simulator they stand over, found by driving it.

A simulator may be a black box, but it can be put into any motion: held there until its delays have
settled, its next step shows the forces.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from scipy.optimize import least_squares
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.effects.motion.base import Motion
from buggy_rl.vehicle import CONTROL_PERIOD, GRAVITY, VehicleDimensions, shift_velocity

Make = Callable[[int], EnvBase]

SPEEDS = (1.0, 3.0)  # [m/s] over which the drive is measured
DRIVES = (0.4, 0.55)  # at which the motor is measured: past any deadband; more would spin wheels
CORNERING_SPEED = 2.5  # [m/s] at which the tyres are measured
SLIPS = 0.5  # [rad] the largest slip angle they are measured at
SETTLING = 40  # steps in which delays and wheel speeds settle
TYRE_EFFECTS = ("tire_grip", "grip_balance", "grip_patch")
# D, C / D and c of a tyre: wide enough for a plain factor and for a slope that never bends.
TYRE_BOUNDS = ([0.05, 0.5, 0.5], [5.0, 100.0, 1.6])


def measured_options(
    make: Make, dimensions: VehicleDimensions | Mapping[str, float] | None = None
) -> dict[str, dict[str, Any]]:
    """Options of the effects that need them, by the effect's name, as `make_effect` takes them.

    Args:
        make: Builds the simulator for a number of cars.
        dimensions: Of the car, or those that differ from the buggy's.

    Raises:
        ValueError: The simulator's answer is not finite.
    """
    if not isinstance(dimensions, VehicleDimensions):
        dimensions = VehicleDimensions(**(dimensions or {}))
    drive, tyres = measured_drive(make), measured_tyres(make, dimensions)
    return {
        "motor_power_limit": {"coasting": drive["coasting"]},
        "top_speed": drive,
        **dict.fromkeys(TYRE_EFFECTS, tyres),
    }


def measured_drive(make: Make) -> dict[str, Any]:
    """What a simulator loses coasting, and what its motor loses with the speed.

    Returns:
        `coasting` c0 [m/s^2], c1 [1/s] and `speed_loss` b0, b1 [1/s], as `TopSpeed` takes them.

    Raises:
        ValueError: The simulator's answer is not finite.
    """
    speeds, dt = torch.linspace(*SPEEDS, 6), _dt(make)
    held = torch.stack([speeds, torch.zeros(6), torch.zeros(6)], -1)

    def line(drive: float) -> tuple[float, float]:
        """Slope [1/s] and level [m/s^2] of the acceleration over the speed."""
        gained = (_next(make, held, 2 * drive - 1)[:, 0] - speeds) / dt
        slope, level = np.polyfit(speeds.numpy(), gained.numpy(), 1)
        return float(slope), float(level)

    rolling, level = line(0.0)
    lost = [rolling - line(drive)[0] for drive in DRIVES]
    growth, rest = np.polyfit(DRIVES, lost, 1)
    return {
        "coasting": [round(max(-level, 0.0), 4), round(max(-rolling, 0.0), 4)],
        "speed_loss": [round(float(rest), 4), round(float(growth), 4)],
    }


def measured_tyres(make: Make, dimensions: VehicleDimensions) -> dict[str, list[float]]:
    """What a simulator's axles give sideways: F = D sin(c atan(C slip / (c D))) of their load.

    The car slides straight ahead at an angle, so both axles have the same slip.

    Returns:
        `friction` D [-], `stiffness` C [1/rad] and `shape` c [-], each of front and rear.

    Raises:
        ValueError: The simulator's answer is not finite.
    """
    d = dimensions
    angle = torch.linspace(-SLIPS, SLIPS, 41)
    at_cg = torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)], -1)
    at_cg[:, :2] *= CORNERING_SPEED
    held = shift_velocity(at_cg, d.sensor_to_cg)
    after = shift_velocity(_next(make, held, -1.0), -d.sensor_to_cg)
    dt = _dt(make)
    motion = Motion(torch.zeros_like(held), at_cg, after, torch.zeros(len(held), 2), dt)
    _, ay, yaw = motion.acceleration
    share = torch.tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
    spin = d.yaw_inertia / d.mass / d.wheelbase * yaw
    force = ay.unsqueeze(-1) + torch.stack([spin, -spin], -1) / share  # (41, 2) over load share
    force = 0.5 * (force.flip(0) - force)  # trim turns both sides alike
    use = (force[21:] / GRAVITY).double().numpy()  # (20, 2) at slips to the left
    a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
    mobility = np.array([[1 + a * a / i, 1 - a * b / i], [1 - a * b / i, 1 + b * b / i]])
    settling = 0.5 * dt * GRAVITY / CORNERING_SPEED * mobility * share.double().numpy()
    slip = angle[21:].double().numpy()
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
    }


def _law(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    return friction * np.sin(shape * np.arctan(ratio / shape * slip))


def _slope(slip: np.ndarray, friction: float, ratio: float, shape: float) -> np.ndarray:
    s = ratio / shape * slip
    return friction * ratio * np.cos(shape * np.arctan(s)).clip(0) / (1 + s * s)


def _law_of(slip: np.ndarray, use: np.ndarray) -> np.ndarray:
    """D, C / D and c of the law that comes closest."""
    first = [max(float(use.max()), 0.1), 8.0, 1.1]
    found = least_squares(lambda x: _law(slip, *x) - use, first, bounds=TYRE_BOUNDS)
    return found.x


def _dt(make: Make) -> float:
    return getattr(make(1), "dt", CONTROL_PERIOD)


@torch.no_grad()
def _next(make: Make, held: Tensor, throttle: float) -> Tensor:
    """Velocity [n, 3] a step after the velocities [n, 3] were held until delays have settled."""
    engine = make(len(held))
    state = engine.reset(TensorDict({keys.VELOCITY: held.clone()}, [len(held)]).to(engine.device))
    action = torch.tensor([throttle, 0.0]).expand(len(held), 2)
    for _ in range(SETTLING):
        state[keys.VELOCITY] = held.to(state[keys.VELOCITY])
        state[keys.ACTION] = action.to(state[keys.VELOCITY])
        state = engine.step(state)["next"]
    after = state[keys.VELOCITY].cpu()
    if not bool(after.isfinite().all()):
        raise ValueError(
            f"the simulator is not finite when held in motion at throttle {throttle} and up to "
            f"{float(held.norm(dim=-1).max()):.1f} m/s"
        )
    return after
