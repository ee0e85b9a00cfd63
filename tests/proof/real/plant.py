"""A car whose motion is known: the single track, driven by a log of commands, as a recording."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.effects.base import EffectParameter
from buggy_rl.recordings import Recording
from buggy_rl.simulators import make_engine
from buggy_rl.task.augment import augmented

SPEED = LongitudinalCommand("speed", reverse=True)
ONE_WAY = LongitudinalCommand()
RESTING = 40  # [rows] at rest at the beginning, longer than any dead time
Effects = Mapping[str, Mapping[str, float]]


def commands(rows: int = 250, command: LongitudinalCommand = ONE_WAY, seed: int = 0) -> Tensor:
    """[T, 2] commands that rest, then vary; a staircase of 0.1 s, as a log at 10 Hz is."""
    time = (CONTROL_PERIOD * torch.arange(rows - RESTING)).mul(10).floor() / 10 + 0.7 * seed
    drive = 0.3 + 0.1 * torch.sin(2.1 * time)
    steering = 0.45 * torch.sin(2 * math.pi * time / 2.3) + 0.1 * torch.sin(5 * time)
    throttle = 2 * drive - 1 if command == ONE_WAY else drive
    moving = torch.stack([throttle, steering], -1)
    resting = torch.tensor([command.rest, 0.0]).expand(RESTING, 2)
    return torch.cat([resting, moving])


def driven(
    actions: Tensor, effects: Effects | None = None, command: LongitudinalCommand = ONE_WAY
) -> TensorDict:
    """Measured motion [T] of the car, from rest, with effects of the library."""
    engine = make_engine("single_track", 1, **({} if command == ONE_WAY else {"command": command}))
    values = {e: {n: torch.full((1,), v) for n, v in p.items()} for e, p in (effects or {}).items()}
    options: dict[str, Any] = {name: {"rest": command.rest} for name in values}
    env, _ = augmented(engine, values, {}, options=options)
    start = {keys.POSE: torch.zeros(1, 3), keys.VELOCITY: torch.zeros(1, 3)}
    state = reset_at(env, TensorDict(start, [1]))

    def act(row, now):
        return now.set(keys.ACTION, actions[row : row + 1].clone())

    pose, velocity = [], []
    for now in trajectory(env, state, act, len(actions) - 1):
        pose.append(now.get(keys.MEASURED_POSE, now[keys.POSE])[0].clone())
        velocity.append(now.get(keys.MEASURED_VELOCITY, now[keys.VELOCITY])[0].clone())
    motion = {keys.POSE: torch.stack(pose), keys.VELOCITY: torch.stack(velocity)}
    return TensorDict({**motion, keys.ACTION: actions}, [len(actions)])


def recording(
    actions: Tensor, name: str = "drive", command: LongitudinalCommand = ONE_WAY
) -> Recording:
    """The car's drive as a recording without noise."""
    motion = driven(actions, None, command)
    rows = len(actions)
    time = CONTROL_PERIOD * torch.arange(rows, dtype=torch.float64).unsqueeze(-1)
    more = {keys.TIME: time, keys.SEGMENT: torch.zeros(rows, dtype=torch.long)}
    return Recording(name, motion.update(more), CONTROL_PERIOD, command=command)


def neutral(parameters: tuple[EffectParameter, ...]) -> dict[str, float]:
    """Values at which an effect changes nothing."""
    return {p.name: p.value for p in parameters}
