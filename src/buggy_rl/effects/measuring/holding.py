"""A simulator held at a velocity until its delays have settled; then its next steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.longitudinal import ONE_WAY_REST, declared_by
from buggy_rl.stepping import trajectory
from buggy_rl.vehicle import CONTROL_PERIOD

Make = Callable[[int], EnvBase]
"""Builds the simulator for a number of environments."""

SETTLING = 0.4  # [s] DART's longest dead time, 0.14 s, and two of its lags of 0.13 s
THROTTLES = (-1.0, 0.0)  # [-] range of commands searched for one that gives an acceleration
DRIVES = (0.0, 0.5)  # [-] the same of a throttle with reverse


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
    searched = THROTTLES if resting(make) == ONE_WAY_REST else DRIVES
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
    state = engine.reset(TensorDict({keys.VELOCITY: held.clone()}, [len(held)]).to(engine.device))
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
