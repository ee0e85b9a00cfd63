"""A simulator held in a motion until its delays have settled; then its next steps."""

from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.vehicle import CONTROL_PERIOD

Make = Callable[[int], EnvBase]

SETTLING = 40  # steps in which delays and wheel speeds settle
THROTTLES = (-1.0, 0.0)  # among which one is looked for that gains so much, or nothing


def period(make: Make) -> float:
    return getattr(make(1), "dt", CONTROL_PERIOD)


def next_velocity(make: Make, held: Tensor, throttle: float | Tensor) -> Tensor:
    """Velocity [n, 3] a step after the velocities [n, 3] were held until delays have settled."""
    return next_velocities(make, held, throttle, 0.0, 0)[0]


def throttle_for(make: Make, speed: float, gained: float) -> float:
    """Throttle with which the simulator, rolling straight ahead, gains [m/s^2] most nearly."""
    throttles = torch.linspace(*THROTTLES, 21)
    held = torch.tensor([[speed, 0.0, 0.0]]).expand(len(throttles), 3)
    after = next_velocity(make, held, throttles)[:, 0]
    return float(throttles[int((after - speed - gained * period(make)).abs().argmin())])


@torch.no_grad()
def next_velocities(
    make: Make, held: Tensor, throttle: float | Tensor, steering: float, rows: int
) -> Tensor:
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
