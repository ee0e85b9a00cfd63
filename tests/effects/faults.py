"""Effects at sizes that can be felt, and cars that feel them."""

import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from buggy_rl.core import keys
from buggy_rl.effects import effect_class, make_effect
from buggy_rl.simulators import make_engine

TOLD = {
    "tire_grip": {"grip": 0.7, "max_acceleration": 4.0},
    "grip_patch": {"x": 0.0, "y": 0.0, "radius": 100.0, "grip": 0.6},
    "motor_power_limit": {"power_per_mass": 3.0},
    "servo_stiction": {"width": 0.3},
}


def fault(name):
    """Values at which an effect is plainly felt: a probe away from neutral, or where told."""
    if name.startswith("term."):
        return {p.name: 2 * p.size for p in effect_class(name).declared}
    return TOLD.get(name) or {p.name: p.value + p.probe for p in effect_class(name).declared}


def neutral(name):
    return {p.name: p.value for p in effect_class(name).declared}


def batched(name, rows):
    """An effect with a set of values for each car."""
    values = {key: torch.tensor([row[key] for row in rows]) for key in rows[0]}
    return make_effect(name).with_parameters(TensorDict(values, [len(rows)]))


def over(effects, engine="hold", batch_size=()):
    engine = make_engine(engine, batch_size) if isinstance(engine, str) else engine
    return TransformedEnv(engine, Compose(*effects))


def start(env, velocity=(0.0, 0.0, 0.0), pose=(0.0, 0.0, 0.0), **state):
    given = TensorDict(batch_size=env.batch_size)
    for key, value in {keys.VELOCITY: velocity, keys.POSE: pose, **state}.items():
        value = torch.as_tensor(value)
        given[key] = value.expand(*env.batch_size, value.shape[-1]).clone()
    return env.reset(given, set_state=True)


def step(env, state, action=(-1.0, 0.0)):
    action = torch.as_tensor(action, dtype=torch.float32)
    return env.step(state.clone().set(keys.ACTION, action.expand(*env.batch_size, 2).clone()))[
        "next"
    ]


def follow(env, state, actions):
    """The states [T] after each of some actions."""
    states = []
    for action in actions:
        state = step(env, state, action)
        states.append(state)
    return torch.stack(states)


def commanded(env, state, actions):
    """The commands [T, *, 2] that reach the engine."""
    reached = []
    inner = env.base_env._step

    def listening(tensordict):
        reached.append(tensordict[keys.ACTION].clone())
        return inner(tensordict)

    env.base_env._step = listening
    try:
        follow(env, state, actions)
    finally:
        env.base_env._step = inner
    return torch.stack(reached)
