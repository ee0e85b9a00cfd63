"""Recordings of single-track cars in which effects or parameters are planted by their own code."""

from collections.abc import Mapping, Sequence
from functools import cache

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.effects import effect_class
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators import make_engine
from buggy_rl.task.augment import augmented

QUIET = CameraConfig(0.0, 0.0, 0.0, 0.0)
PLANTED = {
    "nothing": {},
    "late": {"steering_dead_time": {"dead_time": 0.06}},
    "draggy": {"viscous_drag": {"rate": 0.5}},
    "two": {"steering_gain": {"gain": 0.8}, "viscous_drag": {"rate": 0.5}},
    "heavy": {"parameter": {"drive_force": 4.0}},
}
FEW = ["steering_dead_time", "steering_gain", "steering_offset", "viscous_drag", "gyro_bias"]


@cache
def single_track(cars):
    return make_engine("single_track", cars)


def commands(cars: int, rows: int, seed: int = 0, drive: tuple[float, float] = (0.25, 0.55)):
    """Actions [cars, rows, 2]: throttle and steering held for a while each, then another."""
    generator = torch.Generator().manual_seed(seed)
    hold = 45  # rows
    knots = torch.rand(cars, rows // hold + 1, 2, generator=generator)
    low, high = drive
    throttle = 2 * (low + (high - low) * knots[..., 0]) - 1
    steering = 1.6 * knots[..., 1] - 0.8
    return torch.stack([throttle, steering], -1).repeat_interleave(hold, 1)[:, :rows]


@torch.no_grad()
def driven(engine, effects, parameters, action):
    """True motion [cars, rows] under actions [cars, rows, 2]; values are of each car."""
    env, _ = augmented(engine, effects, parameters)
    state, rows = env.reset(), []
    for row in range(action.shape[1]):
        state[keys.ACTION] = action[:, row]
        rows.append(
            TensorDict(
                {
                    keys.POSE: state.get(keys.MEASURED_POSE, state[keys.POSE]),
                    keys.VELOCITY: state.get(keys.MEASURED_VELOCITY, state[keys.VELOCITY]),
                    keys.ACTION: action[:, row],
                },
                [len(action)],
            )
        )
        state = env.step(state)["next"]
    return TensorDict.stack(rows, 1)


def planted_drives(
    cases: Sequence[Mapping],
    cars: int = 3,
    seconds: float = 10.0,
    seed: int = 0,
    quality: CameraConfig | None = None,
    make=single_track,
    action: torch.Tensor | None = None,
) -> list[list[Recording]]:
    """Drives `cars` cars of each case, all in one batch; effect -> parameter -> value.

    They are told `action` [cars, rows, 2], or else what `commands` draws.
    """
    count = len(cases) * cars
    effects: dict[str, dict[str, torch.Tensor]] = {}
    parameters: dict[str, torch.Tensor] = {}
    engine = make(count)
    for index, case in enumerate(cases):
        rows = slice(index * cars, (index + 1) * cars)
        for name, values in case.items():
            for parameter, value in values.items():
                if name == "parameter":
                    neutral = torch.full((count,), engine.declared[parameter].value)
                    parameters.setdefault(parameter, neutral)[rows] = value
                    continue
                own = {p.name: torch.full((count,), p.value) for p in effect_class(name).declared}
                effects.setdefault(name, own)[parameter][rows] = value
    action = commands(cars, round(100 * seconds), seed) if action is None else action
    action = action.repeat(len(cases), 1, 1)
    true = driven(engine, effects, parameters, action)
    result = []
    for index in range(len(cases)):
        recordings = []
        for car in range(cars):
            row = index * cars + car
            data = Camera(quality, 1000 * seed + row).recorded(true[row])
            recordings.append(Recording(f"drive_{car}", data, 0.01))
        result.append(recordings)
    return result


def problem_of(recordings, effects=FEW, parameters=(), make=single_track, stride=1.0):
    """Segments of recordings against the simulator that they are of."""
    segments, simulation = cut_segments(recordings, 1.0, stride), Simulation(make)
    declared = {name: make(1).declared[name] for name in parameters}
    library = Library(effects, declared)
    return Problem(simulation, segments, noise_model(simulation, segments), library)
