"""Engines reset and stepped by hand."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys


def start(engine, velocity=(0.0, 0.0, 0.0), pose=(0.0, 0.0, 0.0)):
    """The state after a reset at a pose and a velocity, one for all cars or one each."""
    given = TensorDict(batch_size=engine.batch_size, device=engine.device)
    for key, value in ((keys.POSE, pose), (keys.VELOCITY, velocity)):
        value = torch.as_tensor(value, dtype=torch.float32)
        given[key] = value.expand(*engine.batch_size, 3).clone()
    return engine.reset(given, set_state=True)


def step(engine, state, action):
    action = torch.as_tensor(action, dtype=torch.float32, device=engine.device)
    acted = state.clone().set(keys.ACTION, action.expand(*engine.batch_size, 2).clone())
    return engine.step(acted)["next"]


def follow(engine, state, actions):
    """Poses and velocities [T, *, 3] under actions [T, 2] or [T, *, 2], and the last state."""
    poses, velocities = [], []
    for action in actions:
        state = step(engine, state, action)
        poses.append(state[keys.POSE])
        velocities.append(state[keys.VELOCITY])
    return torch.stack(poses), torch.stack(velocities), state
