"""Identification of a simulator's coasting deceleration, back-EMF and motor deadband."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, command_of, declared_by
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD

Make = Callable[[int], EnvBase]
"""Builds the simulator for a number of environments."""

SETTLING = 0.4  # [s] DART's longest dead time, 0.14 s, and two of its lags of 0.13 s
THROTTLES = (-1.0, 0.0)  # [-] range of commands searched for one that gives an acceleration
HELD_DRIVES = (0.0, 0.5)  # [-] the same of a throttle with reverse


def period(make: Make) -> float:
    """Control period of a simulator [s]."""
    return getattr(make(1), "dt", CONTROL_PERIOD)


def resting(make: Make) -> float:
    """Throttle without drive of a simulator."""
    return declared_by(make(1)).rest


def next_velocity(make: Make, held: Tensor, throttle: float | Tensor) -> Tensor:
    """Velocity [n, 3] one step after the velocities [n, 3] were held until delays settled."""
    return next_velocities(make, held, throttle, 0.0, 0)[0]


@dataclass(frozen=True)
class ThrottleSweep:
    """Acceleration of a simulator that rolls straight ahead, over its throttle."""

    throttle: Tensor
    """[n]"""
    acceleration: Tensor
    """[n] [m/s^2]"""

    def throttle_for(self, acceleration: float) -> float:
        """Throttle at which it comes closest to an acceleration [m/s^2]."""
        return float(self.throttle[int((self.acceleration - acceleration).abs().argmin())])


def throttle_sweeps(make: Make, speeds: Sequence[float]) -> list[ThrottleSweep]:
    """Sweeps of the throttle at speeds [m/s], all in one batch."""
    searched = THROTTLES if resting(make) == ONE_WAY_REST else HELD_DRIVES
    throttle, count = torch.linspace(*searched, 21), len(speeds)
    held = torch.zeros(count, len(throttle), 3)
    held[..., 0] = torch.tensor(speeds).unsqueeze(-1)
    held = held.flatten(0, 1)
    after = next_velocity(make, held, throttle.repeat(count))
    gained = (after - held)[:, 0].view(count, -1) / period(make)
    return [ThrottleSweep(throttle, own) for own in gained]


def next_velocities(
    make: Make, held: Tensor, throttle: float | Tensor, steering: float, rows: int
) -> Tensor:
    """Velocities [rows + 1, n, 3], each one step after the velocities [n, 3] were held.

    First straight ahead until all delays have settled, then for `rows` steps with `steering`.

    Raises:
        ValueError: A velocity is not finite.
    """
    engine = make(len(held))
    settling = round(SETTLING / period(make))
    start = TensorDict({keys.VELOCITY: held.clone()}, [len(held)]).to(engine.device)
    state = reset_at(engine, start)
    drive = torch.as_tensor(throttle).expand(len(held))
    straight = torch.stack([drive, torch.zeros_like(drive)], -1)
    turned = torch.stack([drive, torch.full_like(drive, steering)], -1)

    def hold(row: int, state: TensorDictBase) -> TensorDictBase:
        state[keys.VELOCITY] = held.to(state[keys.VELOCITY])
        action = straight if row < settling else turned
        return state.set(keys.ACTION, action.to(state[keys.VELOCITY]))

    states = trajectory(engine, state, hold, settling + rows)
    after = torch.stack([s[keys.VELOCITY].cpu() for s in islice(states, settling, None)])
    if not bool(after.isfinite().all()):
        raise ValueError(
            f"the simulator is not finite when held in motion at throttle {float(drive.max()):g} "
            f"and up to {float(held.norm(dim=-1).max()):.1f} m/s"
        )
    return after


SPEEDS = (1.0, 3.0)  # [m/s] range of the fit of acceleration over speed
ROLLING = 6  # speeds in that range
DRIVES = (0.4, 0.55)  # [-] drives of that fit: above deadbands up to 0.3, below wheel spin
ONSET_SPEEDS = (0.5, 1.0)  # [m/s] speeds from which the onset is extrapolated to rest
ONSETS = (0.0, 0.6)  # [-] range of drives searched for the onset
SETTING_OFF = 25  # drives in that range
LEAST_PULL = 0.2  # [m/s^2] least acceleration of a motor at over half its drive
RISING = (0.1, 0.6)  # [-] shares of the largest acceleration between which a line is fitted


def measured_motor(make: Make) -> dict[str, Any]:
    """What `measured_drive` and `measured_onset` find, of one batch.

    Raises:
        ValueError: A velocity of the simulator is not finite, or the motor gives no force.
    """
    trials = (_rolling(make), _setting_off(make))
    held, throttle = (torch.cat(parts) for parts in zip(*trials, strict=True))
    after = next_velocity(make, held, throttle)
    rolled, set_off = after.split([len(own) for own, _ in trials])
    return _losses(rolled, period(make)) | {"onset": _onset(set_off, period(make))}


def measured_drive(make: Make) -> dict[str, Any]:
    """Deceleration while coasting, and decrease of the motor's acceleration with the speed.

    Returns:
        `coasting` c0 [m/s^2], c1 [1/s] and `speed_loss` b0, b1 [1/s], as `TopSpeed` takes them.

    Raises:
        ValueError: A velocity of the simulator is not finite.
    """
    return _losses(next_velocity(make, *_rolling(make)), period(make))


def measured_onset(make: Make) -> float:
    """Drive in 0..1 at which a simulator's motor begins to give force, at rest.

    The acceleration over the drive is a line above the onset; it is extrapolated down to the
    coasting acceleration, and from two speeds to rest, because back-EMF takes some drive too.

    Raises:
        ValueError: A velocity of the simulator is not finite, or the motor gives no force.
    """
    return _onset(next_velocity(make, *_setting_off(make)), period(make))


def _rolling(make: Make) -> tuple[Tensor, Tensor]:
    """Velocities [n, 3] that are held, and throttles [n]: without drive and with some."""
    speeds, drives = torch.linspace(*SPEEDS, ROLLING), torch.tensor([0.0, *DRIVES])
    held = torch.zeros(len(drives), len(speeds), 3)
    held[..., 0] = speeds
    throttle = command_of(drives, resting(make)).repeat_interleave(len(speeds))
    return held.flatten(0, 1), throttle


def _losses(after: Tensor, dt: float) -> dict[str, Any]:
    speeds = torch.linspace(*SPEEDS, ROLLING)
    acceleration = (after[:, 0].view(-1, len(speeds)) - speeds) / dt
    # Slope [1/s] and level [m/s^2] over the speed, of each drive.
    slopes, levels = np.polyfit(speeds.numpy(), acceleration.T.numpy(), 1)
    (rolling, *driven), level = slopes.tolist(), float(levels[0])
    lost = [rolling - slope for slope in driven]
    growth, standing = np.polyfit(DRIVES, lost, 1)
    return {
        "coasting": [round(max(-level, 0.0), 4), round(max(-rolling, 0.0), 4)],
        "speed_loss": [round(float(standing), 4), round(float(growth), 4)],
    }


def _setting_off(make: Make) -> tuple[Tensor, Tensor]:
    """Velocities [n, 3] that are held, and throttles [n]: every drive at two low speeds."""
    drives = torch.linspace(*ONSETS, SETTING_OFF)
    held = torch.zeros(len(ONSET_SPEEDS), len(drives), 3)
    held[..., 0] = torch.tensor(ONSET_SPEEDS).unsqueeze(-1)
    return held.flatten(0, 1), command_of(drives, resting(make)).repeat(len(ONSET_SPEEDS))


def _onset(after: Tensor, dt: float) -> float:
    drives, found = torch.linspace(*ONSETS, SETTING_OFF), []
    gained = after[:, 0].view(len(ONSET_SPEEDS), -1)
    for speed, velocity in zip(ONSET_SPEEDS, gained, strict=True):
        acceleration = (velocity - speed) / dt
        pull = (acceleration - acceleration[0]).double()
        top = float(pull.max())
        if top < LEAST_PULL:
            raise ValueError(f"at {speed:g} m/s no drive up to {ONSETS[1]:g} makes it faster")
        rising = (pull > RISING[0] * top) & (pull < RISING[1] * top)
        if int(rising.sum()) < 2:
            raise ValueError(
                f"at {speed:g} m/s its acceleration jumps with the drive: no line to an onset"
            )
        slope, level = np.polyfit(drives[rising].numpy(), pull[rising].numpy(), 1)
        found.append(-level / slope)
    low, high = ONSET_SPEEDS
    at_rest = found[0] - low * (found[1] - found[0]) / (high - low)
    return round(float(np.clip(at_rest, *ONSETS)), 3)
