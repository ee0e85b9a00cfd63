"""A simulator's own steps tell of a heading in degrees and of a velocity in the world's axes."""

import math

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core.vehicle import rotate
from buggy_rl.diagnosis.preflight.simulator import check_axes
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.single_track import KinematicEngine

CARS, DEGREE = 5, 180 / math.pi


class InDegrees(KinematicEngine):
    """Shows its heading in degrees, and takes it so; its yaw rate is in rad/s."""

    def _advance(self, state, action):
        state = state.clone()
        state[keys.POSE] = state[keys.POSE] * torch.tensor([1.0, 1.0, 1 / DEGREE])
        result = dict(super()._advance(state, action))
        return {**result, keys.POSE: result[keys.POSE] * torch.tensor([1.0, 1.0, DEGREE])}


class OfTheWorld(KinematicEngine):
    """Shows its velocity along the world's axes, and takes it so."""

    def _advance(self, state, action):
        state, turned = state.clone(), state[keys.POSE][..., 2]
        state[keys.VELOCITY] = self._turned(state[keys.VELOCITY], -turned)
        result = dict(super()._advance(state, action))
        turned = result[keys.POSE][..., 2]
        return {**result, keys.VELOCITY: self._turned(result[keys.VELOCITY], turned)}

    def _turned(self, velocity, angle):
        return torch.cat([rotate(velocity[..., :2], angle), velocity[..., 2:]], -1)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (InDegrees, "odd: its heading seems to be in degrees"),
        (OfTheWorld, "odd: its velocity seems to be the world's"),
    ],
)
def test_axes_that_are_not_the_contracts_are_refused_by_name(kind, words):
    with pytest.raises(ValueError, match=words):
        check_axes(kind([CARS]), "odd", 0.01)


@pytest.mark.parametrize("name", ["kinematic", "single_track", "reference", "hold"])
def test_simulators_of_the_contract_pass(name):
    check_axes(make_engine(name, CARS), name, 0.01)


def test_a_gymnasium_environment_is_refused_with_what_is_expected(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "import gymnasium\n\n\nclass Car(gymnasium.Env):\n    pass\n\n\n"
        "def make(batch_size, device):\n    return Car()\n"
    )
    with pytest.raises(ValueError, match=r"returned a .*mine.*Car: a factory must return a Torch"):
        make_engine(f"{file}:make", 2)
