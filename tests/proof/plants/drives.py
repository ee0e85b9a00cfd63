"""Short drives of plants, to compare a faulty car with a sound one."""

from functools import cache
from importlib.util import find_spec

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.proof.plants import make_plant

STEP = 0.01  # [s]
MASS = 1.625  # [kg]
# What wheels that turn along add to the mass: sum I / R^2 with R = 32.5 mm.
WHEELS = {
    "mujoco": 0.140,  # (4 x 2.2e-5 + 2 x 3.0e-5) kg m^2
    "commonroad": 0.189,  # 2 x 1.0e-4 kg m^2
}
COMMONROAD = pytest.param(
    "commonroad",
    marks=pytest.mark.skipif(
        find_spec("vehiclemodels") is None, reason="commonroad-vehicle-models is not installed"
    ),
)
FOREIGN = ("mujoco", COMMONROAD)
EVERY = ("reference", *FOREIGN)


@cache
def sound(plant):
    return make_plant(plant, 1, {})


def faulty(plant, effect, **parameters):
    return make_plant(plant, 1, {effect: parameters})


def start(car, velocity=(0.0, 0.0, 0.0), pose=(0.0, 0.0, 0.0)):
    given = {keys.POSE: torch.tensor([pose]), keys.VELOCITY: torch.tensor([velocity])}
    return car.reset(TensorDict(given, [1]), set_state=True)


@torch.no_grad()
def follow(car, state, actions):
    """Velocities [T, 3] and the last state under actions, [(steps, throttle, steering)]."""
    velocities = []
    for steps, throttle, steering in actions:
        for _ in range(steps):
            acted = state.clone().set(keys.ACTION, torch.tensor([[throttle, steering]]))
            state = car.step(acted)["next"]
            velocities.append(state[keys.VELOCITY][0].double())
    return torch.stack(velocities), state


def drive(car, *actions, velocity=(0.0, 0.0, 0.0), pose=(0.0, 0.0, 0.0)):
    """Velocities [T, 3] from a start."""
    return follow(car, start(car, velocity, pose), actions)[0]


@cache
def _sound_drive(plant, velocity, *actions):
    return follow(sound(plant), start(sound(plant), velocity), actions)


def sound_drive(plant, *actions, velocity=(0.0, 0.0, 0.0)):
    """Velocities [T, 3] of a sound car from a start, which is driven once."""
    return _sound_drive(plant, velocity, *actions)[0]


def warmed(plant, *actions, velocity=(0.0, 0.0, 0.0)):
    """The state of a sound car after some actions."""
    return _sound_drive(plant, velocity, *actions)[1].clone()


def gained(car, state, steps, throttle, steering=0.0):
    """Mean forward acceleration [m/s^2] over some steps, once a period has settled wheel slips."""
    velocities, _ = follow(car, state, [(steps + 2, throttle, steering)])
    return float(velocities[-1, 0] - velocities[1, 0]) / (steps * STEP)
