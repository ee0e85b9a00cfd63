"""Step tests within what was driven: what a simulator does, whatever its parameters are called.

Parameters trade off against one another (a dead time against a lag and a late sensor, mass against
drive), so that each is uncertain while what they do together is not. Each number here is of what a
driver could measure: half-response times, curvatures, accelerations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.estimation.rollout import Simulation, sensed
from buggy_rl.estimation.segments import Segments

HELD = 0.5  # [s] of a steady command before a step
AFTER = 1.0  # [s] after it
SETTLED = 0.3  # [s] at the end over which a steady state is averaged
EARLY = 0.3  # [s] after a step of the throttle in which the acceleration reaches its final value
SLOW, TYPICAL, QUICK = 0.2, 0.5, 0.9  # quantiles of the driven speed
LOCK = 0.98  # quantile of the magnitude of driven steering that stands for full lock
NEAR = 0.2  # share of the speed range within which a throttle belongs to a speed
OFTEN = 0.01  # share of the rows from which something was driven
FAR, STRAIGHT = 0.8, 0.15  # shares of full lock beyond and within which it is steered so
IDLE = 0.02  # [-] throttle command from rest within which nothing drives
VARIED = 0.1  # standard deviation of a command, over its range, from which steps of it were driven
STANDS = 0.2  # share of the speed at the start below which a car has stopped


@dataclass(frozen=True)
class Quantity:
    """One number of a step test."""

    name: str
    words: str
    unit: str
    least: float
    """Difference from which it matters, in its unit; 0 for the share `RELEVANT` of its size."""


@dataclass(frozen=True)
class Driven:
    """Speeds and commands that recordings show, as step tests need them."""

    slow: float
    typical: float
    quick: float
    """[m/s] quantiles of the driven speed."""
    throttle: tuple[float, float, float]
    """Median throttle command near each of the three speeds."""
    full: float
    """High throttle command (quantile `QUICK`)."""
    lock: float
    """Steering command that stands for full lock."""
    rest: float
    """Throttle command without drive."""
    shown: frozenset[str] = frozenset()
    """Names of the quantities that were driven: of others a simulator would have to be believed."""

    @classmethod
    def of(cls, segments: Segments, rest: float) -> "Driven":
        """Speeds and commands that segments show."""
        speed = segments.smooth_velocity[..., 0].flatten()
        throttle, steering = segments.action.flatten(0, 1).unbind(-1)
        ahead = speed > 0
        speed, throttle, steering = speed[ahead], throttle[ahead], steering[ahead]
        slow, typical, quick = (float(_quantile(speed, q)) for q in (SLOW, TYPICAL, QUICK))
        near = [
            float(throttle[(speed - v).abs() <= max(NEAR * (quick - slow), 0.05 * v)].median())
            for v in (slow, typical, quick)
        ]
        lock = float(_quantile(steering.abs(), LOCK))
        full = float(_quantile(throttle, QUICK))
        throttles, shown = (near[0], near[1], near[2]), _shown(throttle, steering / lock, rest)
        return cls(slow, typical, quick, throttles, full, lock, rest, shown)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities of the tests, in the order of `step_tests`."""
        lock, slow = f"{self.lock:.2f}", f"{self.slow:.2g} m/s"
        return (
            Quantity(
                "steering_response", "from a steering step to half of the yaw rate", "s", 0.01
            ),
            Quantity(
                "throttle_response", "from a throttle step to half of the acceleration", "s", 0.01
            ),
            Quantity("left_curvature", f"curvature with steering +{lock} at {slow}", "1/m", 0.0),
            Quantity("right_curvature", f"curvature with steering -{lock} at {slow}", "1/m", 0.0),
            Quantity(
                "straight_curvature",
                f"curvature without steering at {self.typical:.2g} m/s (left is positive)",
                "1/m",
                0.01,
            ),
            Quantity(
                "acceleration",
                f"acceleration with throttle {self.full:.2f} at {self.typical:.2g} m/s",
                "m/s^2",
                0.0,
            ),
            Quantity(
                "coasting", f"acceleration without drive at {self.quick:.2g} m/s", "m/s^2", 0.0
            ),
            Quantity(
                "lateral_acceleration",
                f"lateral acceleration with steering {lock} at {self.quick:.2g} m/s",
                "m/s^2",
                0.0,
            ),
        )


def _shown(throttle: Tensor, steering: Tensor, rest: float) -> frozenset[str]:
    """Quantities that rows [T] of commands show, steering as a share of full lock."""
    share = {
        "left_curvature": steering > FAR,
        "right_curvature": steering < -FAR,
        "straight_curvature": steering.abs() < STRAIGHT,
        "coasting": (throttle - rest).abs() < IDLE,
        "acceleration": (throttle - rest).abs() >= IDLE,
        "lateral_acceleration": steering.abs() > FAR,
    }
    often = {name for name, rows in share.items() if float(rows.double().mean()) > OFTEN}
    if float(steering.std()) > VARIED:
        often.add("steering_response")
    if float(throttle.std()) > VARIED * float(throttle.max() - rest):
        often.add("throttle_response")
    return frozenset(often)


def step_tests(
    simulation: Simulation,
    library: Library,
    rows: Sequence[tuple[Hypothesis, Tensor]],
    driven: Driven,
    dt: float,
) -> Tensor:
    """Quantities [S, Q] of a simulator with S hypotheses, each at its vector [P]; in one rollout.

    Times count from the stamp of the command, so they hold the clock's offset. A quantity that a
    test does not show, since the car stops in it, is nan.
    """
    actions, speeds = _tests(driven, dt)
    samples, count = len(rows), len(actions)
    cars = samples * count
    start = TensorDict(
        {keys.POSE: torch.zeros(cars, 3), keys.VELOCITY: torch.zeros(cars, 3)}, [cars]
    )
    start[keys.VELOCITY][:, 0] = speeds.repeat(samples)
    settings = library.settings(rows)
    states = simulation.drive(actions.repeat(samples, 1, 1), settings, start)
    read = torch.stack([sensed(state)[:, 3:] for state in states], 1)  # (S * B, T, 3)
    late = settings.clock_offset.double()  # (S,)
    return _measured(read.view(samples, count, -1, 3).double(), late, dt)


def _tests(d: Driven, dt: float) -> tuple[Tensor, Tensor]:
    """Commands [B, T, 2] of the tests and the speeds [B] at which they start."""
    slow, typical, quick = d.throttle
    plan = [  # speed, throttle before, after the step, steering before, after
        (d.typical, typical, typical, 0.0, 0.5 * d.lock),
        (d.typical, typical, typical, 0.0, -0.5 * d.lock),
        (d.quick, d.rest, d.full, 0.0, 0.0),
        (d.slow, slow, slow, d.lock, d.lock),
        (d.slow, slow, slow, -d.lock, -d.lock),
        (d.typical, typical, typical, 0.0, 0.0),
        (d.typical, d.full, d.full, 0.0, 0.0),
        (d.quick, d.rest, d.rest, 0.0, 0.0),
        (d.quick, quick, quick, d.lock, d.lock),
        (d.quick, quick, quick, -d.lock, -d.lock),
    ]
    before, after = round(HELD / dt), round(AFTER / dt)
    actions = torch.empty(len(plan), before + after, 2)
    for row, (_, idle, drive, straight, steer) in enumerate(plan):
        actions[row, :before] = torch.tensor([idle, straight])
        actions[row, before:] = torch.tensor([drive, steer])
    return actions, torch.tensor([p[0] for p in plan])


def _measured(read: Tensor, late: Tensor, dt: float) -> Tensor:
    """Quantities [S, Q] of readings [S, B, T, 3] and clock offsets [S]."""
    vx, vy, yaw_rate = read.unbind(-1)
    step, end = round(HELD / dt) - 1, max(2, round(SETTLED / dt))
    speed = torch.hypot(vx, vy)
    steady = speed[..., -end:].mean(-1)
    moving = steady > STANDS * speed[..., 0]
    curvature = torch.where(moving, yaw_rate[..., -end:].mean(-1) / steady, torch.nan)  # (S, B)
    turned = yaw_rate[:, :2, step:]
    turning = _half_time(turned, turned[..., -end:].mean(-1), dt).mean(1)
    change = vx[:, 2].diff(dim=-1) / dt
    early = max(2, round(EARLY / dt))
    pulled = change[:, step:].unfold(-1, 3, 1).mean(-1)
    driving = _half_time(pulled, pulled[..., early : 2 * early].mean(-1), dt) + 1.5 * dt
    mean = change_between(vx, step, early, dt)
    # a_y = dv_y/dt + v_x yaw_rate, averaged: yaw rate alone shoots up where a car begins to spin.
    rows = slice(step // 2, step // 2 + early)
    side = change_between(vy, step, early, dt) + (vx * yaw_rate)[..., rows].mean(-1)
    columns = [
        turning + late,
        driving + late,
        curvature[:, 3],
        curvature[:, 4],
        curvature[:, 5],
        mean[:, 6],
        mean[:, 7],
        side[:, 8:].abs().mean(-1),
    ]
    return torch.stack(columns, -1)


def change_between(vx: Tensor, step: int, rows: int, dt: float) -> Tensor:
    """Mean acceleration [*] of speeds [*, T] over some rows that begin half of `step` after row 0.

    The first half is left out: there actuators and wheels settle.
    """
    first = step // 2
    return (vx[..., first + rows] - vx[..., first]) / (rows * dt)


def _half_time(values: Tensor, final: Tensor, dt: float) -> Tensor:
    """Time [*] at which values [*, T] first come half of the way from their first to `final`."""
    begin = values[..., :1]
    way = final.unsqueeze(-1) - begin
    share = (values - begin) / torch.where(way.abs() > 1e-9, way, torch.nan)
    reached = share >= 0.5
    row = reached.int().argmax(-1).clamp_min(1)
    before, at = (share.gather(-1, (row - k).unsqueeze(-1)).squeeze(-1) for k in (1, 0))
    inside = ((0.5 - before) / (at - before)).clamp(0.0, 1.0)
    time = (row - 1 + inside) * dt
    return torch.where(reached.any(-1) & ~reached[..., 0], time, torch.nan)


def _quantile(values: Tensor, share: float) -> Tensor:
    """A quantile; torch's own takes no more than 16 million values."""
    return values.sort().values[round(share * (len(values) - 1))]
