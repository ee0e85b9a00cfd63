"""Starts, commands and drives of the reference car, for its tests."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.simulators.reference.state import WHEEL_SLIP

SYMMETRIC = {"lock_left": 0.36, "lock_right": 0.36, "steering_trim": 0.0}


def start(velocity, pose=None):
    velocity = torch.as_tensor(velocity, dtype=torch.float32)
    pose = torch.zeros_like(velocity) if pose is None else torch.as_tensor(pose)
    return TensorDict({keys.POSE: pose, keys.VELOCITY: velocity}, velocity.shape[:-1])


@torch.no_grad()
def drive(engine, state, actions):
    """States [T + 1, *] from a start under actions [T, *, 2] or [T, 2]."""
    state = engine.reset(state.clone(), set_state=True) if WHEEL_SLIP not in state else state
    states = [state.select(*engine.state_spec.keys())]
    for action in torch.as_tensor(actions, dtype=torch.float32):
        step = states[-1].clone().set(keys.ACTION, action.expand(*engine.batch_size, 2))
        states.append(engine.step(step)["next"].select(*engine.state_spec.keys()))
    return torch.stack(states)


def held(throttle, steering, seconds):
    return torch.tensor([throttle, steering]).expand(round(100 * seconds), 2)


def varied(batch, seconds, seed=0):
    """Starts up to 3.5 m/s and commands that change five times a second, all random."""
    draw = torch.Generator().manual_seed(seed)
    span = torch.tensor([3.5, 0.3, 2.0])
    velocity = (torch.rand(batch, 3, generator=draw) - torch.tensor([0.0, 0.5, 0.5])) * span
    velocity[: batch // 8] = 0
    actions = 2 * torch.rand(round(5 * seconds), batch, 2, generator=draw) - 1
    return start(velocity), actions.repeat_interleave(20, 0)
