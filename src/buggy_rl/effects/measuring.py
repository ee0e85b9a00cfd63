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
ONSET_SPEEDS = (0.5, 1.0)  # [m/s] at which the motor's onset is looked for
ONSETS = (0.0, 0.6)  # of the drive, between which it is looked for
SERVO_SPEED = 2.0  # [m/s] at which the servo is measured,
SERVO_STEP = 0.15  # by a step of the steering so small that no servo is at its fastest,
SERVO_ROWS = 60  # that it has this many rows to follow
SERVO_EFFECTS = ("steering_backlash", "steering_rate_limit")
PULL_EFFECTS = ("throttle_gain", "battery_sag")
YAW_EFFECTS = ("one_sided_drag", "yaw_damping")
TYPICAL = (6.1, 9.4)  # [1/rad] stiffness over load of front and rear: DART's
TYRE_EFFECTS = ("tire_grip", "grip_balance", "grip_patch")
# D, C / D and c of a tyre: wide enough for a plain factor and for a slope that never bends.
LEAST_PULL = 0.2  # [m/s^2] of any motor at over half its drive
LEAST_TURN = 0.5  # [rad/s^2] of any car that steers
LEAST_USE = 0.2  # of its load with which any tyre pushes back that slides sideways
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
    options: dict[str, dict[str, Any]] = {}
    for part in (
        _drive_options(make),
        _servo_options(make),
        _tyre_options(make, dimensions),
    ):
        _add(options, part)
    return options


def _add(options: dict[str, dict[str, Any]], more: Mapping[str, Mapping[str, Any]]) -> None:
    for name, values in more.items():
        options[name] = {**options.get(name, {}), **values}


def _drive_options(make: Make) -> dict[str, dict[str, Any]]:
    drive, onset = measured_drive(make), {"onset": measured_onset(make)}
    loss = {"speed_loss": drive["speed_loss"]}
    return {
        **dict.fromkeys(PULL_EFFECTS, onset),
        **dict.fromkeys(TYRE_EFFECTS, loss),
        "motor_power_limit": {"coasting": drive["coasting"]},
        "top_speed": drive,
    }


def _servo_options(make: Make) -> dict[str, dict[str, Any]]:
    lag = {"lag": measured_steering_lag(make)}
    return dict.fromkeys(SERVO_EFFECTS, lag)


def _tyre_options(make: Make, dimensions: VehicleDimensions) -> dict[str, dict[str, Any]]:
    tyres = measured_tyres(make, dimensions)
    stiffness = {"stiffness": tyres["stiffness"]}
    return {name: tyres for name in TYRE_EFFECTS} | {name: stiffness for name in YAW_EFFECTS}


def measurable_options(make: Make) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Options as far as a simulator shows them, and in words what it does not show.

    A simulator that was never taught to slide, such as a learned one, has no tyre law to be read
    off; its effects keep the defaults of their classes.
    """
    parts = {
        "drive": lambda: _drive_options(make),
        "servo": lambda: _servo_options(make),
        "tyres": lambda: _tyre_options(make, VehicleDimensions()),
    }
    # What is not measured is the defaults of the effects' classes, but for this.
    options: dict[str, dict[str, Any]] = {n: {"stiffness": [*TYPICAL]} for n in YAW_EFFECTS}
    failures = []
    for part, measured in parts.items():
        try:
            _add(options, measured())
        except ValueError as error:
            failures.append(f"{part} cannot be measured ({error}): what is typical is assumed")
    return options, failures


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


def measured_onset(make: Make) -> float:
    """Drive in 0..1 at which a simulator's motor begins to pull, at rest.

    From the line that the acceleration follows once it pulls, back to what the car loses coasting;
    and from two speeds back to rest, because a turning motor asks for some drive by itself.

    Raises:
        ValueError: The simulator's answer is not finite, or it does not pull.
    """
    drives = torch.linspace(*ONSETS, 25)
    found = []
    for speed in ONSET_SPEEDS:
        held = torch.tensor([[speed, 0.0, 0.0]]).expand(len(drives), 3)
        gained = (_next(make, held, 2 * drives - 1)[:, 0] - speed) / _dt(make)
        pull = (gained - gained[0]).double()
        top = float(pull.max())
        if top < LEAST_PULL:
            raise ValueError(f"at {speed:g} m/s no drive up to {ONSETS[1]:g} makes it faster")
        rising = (pull > 0.1 * top) & (pull < 0.6 * top)
        if int(rising.sum()) < 2:
            raise ValueError(f"at {speed:g} m/s its pull jumps: there is no line to an onset")
        slope, level = np.polyfit(drives[rising].numpy(), pull[rising].numpy(), 1)
        found.append(-level / slope)
    low, high = ONSET_SPEEDS
    at_rest = found[0] - low * (found[1] - found[0]) / (high - low)
    return round(float(np.clip(at_rest, *ONSETS)), 3)


def measured_steering_lag(make: Make) -> float:
    """Time constant [s] with which a simulator's wheels follow a step of the steering.

    The car is held in straight motion; what its next step would turn grows as the wheels do. Of
    what is still missing, the logarithm falls by dt / T each step: no dead time changes that.

    Raises:
        ValueError: The simulator's answer is not finite, or it does not turn.
    """
    dt = _dt(make)
    held = torch.tensor([[SERVO_SPEED, 0.0, 0.0]])
    turn = _rows(make, held, -1.0, SERVO_STEP, SERVO_ROWS)[:, 0, 2].double()  # (R,)
    turn = turn - turn[0]
    last = float(turn[-1])
    if abs(last) / dt < LEAST_TURN:
        raise ValueError(f"at {SERVO_SPEED:g} m/s it does not turn for steering {SERVO_STEP:g}")
    missing = 1 - turn / last
    falling = (missing < 0.85) & (missing > 0.05)
    gone = falling.logical_not().nonzero().flatten()
    first = int(falling.nonzero()[0]) if bool(falling.any()) else 0
    end = int(gone[gone > first][0]) if bool(falling.any()) else 0
    if end - first < 2:  # over before it can be seen
        return 0.0
    row = np.arange(first, end)
    fall = np.polyfit(row * dt, missing[first:end].log().numpy(), 1)[0]
    if -fall * SERVO_ROWS * dt < 1:
        raise ValueError(f"its wheels have not come to rest {SERVO_ROWS * dt:g} s after a step")
    return round(-1.0 / float(fall), 4)


def measured_tyres(make: Make, dimensions: VehicleDimensions) -> dict[str, list[float]]:
    """What a simulator's axles give sideways: F = D sin(c atan(C slip / (c D))) of their load.

    The car slides straight ahead at an angle, so both axles have the same slip.

    Returns:
        `friction` D [-], `stiffness` C [1/rad] and `shape` c [-], each of front and rear.

    Raises:
        ValueError: The simulator's answer is not finite, or no tyre's.
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


def _dt(make: Make) -> float:
    return getattr(make(1), "dt", CONTROL_PERIOD)


def _next(make: Make, held: Tensor, throttle: float | Tensor) -> Tensor:
    """Velocity [n, 3] a step after the velocities [n, 3] were held until delays have settled."""
    return _rows(make, held, throttle, 0.0, 0)[0]


@torch.no_grad()
def _rows(make: Make, held: Tensor, throttle: float | Tensor, steering: float, rows: int) -> Tensor:
    """Velocities [rows + 1, n, 3], each a step after the velocities [n, 3] were held.

    First until all delays have settled, then for `rows` steps with `steering`.
    """
    engine = make(len(held))
    state = engine.reset(TensorDict({keys.VELOCITY: held.clone()}, [len(held)]).to(engine.device))
    drive = torch.as_tensor(throttle).expand(len(held))
    straight = torch.stack([drive, torch.zeros_like(drive)], -1)
    turned = torch.stack([drive, torch.full_like(drive, steering)], -1)
    found = []
    for row in range(SETTLING + rows):
        state[keys.VELOCITY] = held.to(state[keys.VELOCITY])
        state[keys.ACTION] = (straight if row < SETTLING else turned).to(state[keys.VELOCITY])
        state = engine.step(state)["next"]
        if row >= SETTLING - 1:
            found.append(state[keys.VELOCITY].cpu())
    after = torch.stack(found)
    if not bool(after.isfinite().all()):
        raise ValueError(
            f"the simulator is not finite when held in motion at throttle {float(drive.max()):g} "
            f"and up to {float(held.norm(dim=-1).max()):.1f} m/s"
        )
    return after
