"""MuJoCo's own system identification."""

import numpy as np
import pytest

from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.proof.baselines.sysid import Residuals, identified
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import planted_drives
from tests.proof.baselines.folder import shown


def mujoco(cars):
    return make_engine("mujoco", cars)


def test_it_answers_for_mujoco_cars_alone(drives, tmp_path):
    said = identified(shown(tmp_path, drives["weak"]))
    assert (said["verdict"], said["effects"]) == ("cannot_tell", [])
    assert said["notes"] == ["mujoco.sysid fits MuJoCo models, and this is none"]


@pytest.mark.slow
def test_the_parameter_that_is_off_is_named(tmp_path):
    planted = {"parameter": {"steering_left": 0.22}}  # 0.36 rad in the simulator
    drives = planted_drives([planted], cars=1, seconds=7.0, make=mujoco)[0]
    effect = identified(shown(tmp_path, drives, "mujoco"))["effects"][0]
    assert effect["name"] == "parameter:steering_left"
    assert effect["parameters"]["steering_left"]["value"] == pytest.approx(0.22, rel=0.05)


def test_sets_of_parameters_are_rolled_out_in_one_batch(drives):
    def make(cars):
        return make_engine("single_track", cars)

    grip = make(1).declared["front_grip"]
    residuals = Residuals(Simulation(make), cut_segments(drives["nothing"][:1], 1.0, 4.0), [grip])
    scaled = np.array([[0.2, 0.7]])  # of one parameter, two sets
    both = residuals(scaled, None)[0][0]
    one = residuals(scaled[:, 1], None)[0][0]
    assert both.shape == (len(one), 2)
    np.testing.assert_allclose(both[:, 1], one, atol=1e-5)
    assert np.abs(both[:, 0] - one).max() > 1e-3
