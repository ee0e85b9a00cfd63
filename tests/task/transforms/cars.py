"""A car on a known path, moved by a real engine that does just what it is told."""

import torch
from tensordict import TensorDict
from torchrl.envs import Compose

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.task.paths.path_set import equal_paths
from buggy_rl.task.stack import StackedEnv


def straight_path(count=30, closed=False):
    """Waypoints at x = 0, 1, 2, ... on y = 0."""
    points = torch.zeros(1, count, 2)
    points[0, :, 0] = torch.arange(count)
    return equal_paths(["straight"], points.numpy(), closed)


def square_path():
    """A closed square of 4 m with a waypoint each metre, counter-clockwise, from (0, 0) along x."""
    side = torch.arange(4.0)
    zero, four = torch.zeros(4), torch.full((4,), 4.0)
    x = torch.cat([side, four, 4 - side, zero])
    y = torch.cat([zero, side, four, 4 - side])
    return equal_paths(["square"], torch.stack([x, y], -1)[None].numpy(), closed=True)


def over_hold(*transforms, batch_size=()):
    """Transforms over the engine that keeps its velocity: a car goes where it is put."""
    return StackedEnv(make_engine("hold", batch_size), Compose(*transforms))


def start(env, velocity=(0.0, 0.0, 0.0), pose=None, **state):
    """After a reset with a velocity, and where else it is said."""
    given = TensorDict(batch_size=env.batch_size)
    for key, value in {keys.VELOCITY: velocity, keys.POSE: pose, **state}.items():
        if value is not None:
            value = torch.as_tensor(value)
            given[key] = value.expand(*env.batch_size, *value.shape[-1:]).clone()
    return env.reset(given, set_state=True)


def step(env, state, action=(-1.0, 0.0), **edits):
    """What follows a state under an action; `edits` are put into the state first."""
    acted = state.clone()
    for key, value in {keys.ACTION: action, **edits}.items():
        value = torch.as_tensor(value, dtype=acted.get(key, torch.zeros(())).dtype)
        acted[key] = value.expand(*env.batch_size, *value.shape[-1:]).clone()
    return env.step(acted)["next"]


def place(env, state, x, y, yaw=0.0):
    """The step in which a standing car finds itself at (x, y)."""
    return step(env, state, pose=(float(x), float(y), float(yaw)))
