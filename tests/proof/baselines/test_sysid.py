"""MuJoCo's own system identification."""

import numpy as np
import pytest
import torch

from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.proof.baselines.sysid import Identified, Residuals, directions, identified
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import planted_drives
from tests.proof.baselines.folder import shown


def mujoco(cars):
    return make_engine("mujoco", cars)


def test_it_answers_for_mujoco_cars_alone(drives, tmp_path):
    said = identified(shown(tmp_path, drives["weak"]))
    assert (said["verdict"], said["effects"]) == ("cannot_tell", [])
    assert said["notes"] == ["mujoco.sysid fits MuJoCo models, and this is none"]


@pytest.fixture(scope="module")
def mujoco_drives():
    """Drives of MuJoCo cars with a steering that turns less far, less grip, and nothing."""
    planted = [
        {"parameter": {"steering_left": 0.22}},  # 0.36 rad in the simulator
        {"parameter": {"grip_front": 0.6, "grip_rear": 0.6}},  # 0.9
        {},
    ]
    return planted_drives(planted, cars=1, seconds=14.0, make=mujoco)


@pytest.mark.slow
def test_the_parameter_that_is_off_is_named(mujoco_drives, tmp_path):
    effect = identified(shown(tmp_path, mujoco_drives[0], "mujoco"))["effects"][0]
    assert effect["name"] == "parameter:steering_left"
    assert effect["parameters"]["steering_left"]["value"] == pytest.approx(0.22, rel=0.1)


@pytest.mark.slow
def test_an_effect_that_is_several_parameters_is_named(mujoco_drives, tmp_path):
    effect = identified(shown(tmp_path, mujoco_drives[1], "mujoco"))["effects"][0]
    assert effect["name"] == "tire_grip"
    assert effect["parameters"]["grip"]["value"] == pytest.approx(2 / 3, rel=0.1)


@pytest.mark.slow
def test_nothing_is_named_of_a_car_as_it_is(mujoco_drives, tmp_path):
    said = identified(shown(tmp_path, mujoco_drives[2], "mujoco"))
    assert (said["verdict"], said["effects"]) == ("no_mismatch", [])


def test_a_move_along_an_effect_is_found_whatever_moves_beside_it():
    # Two parameters that trade: along (1, -1) the curvature is 2 (100 - 99) = 2.
    fit = Identified(np.array([1.5, 0.5]), np.array([[100.0, 99.0], [99.0, 100.0]]))
    # H D = (199.5, 198.5): along (1, 1) 398 / 398 = 1 with the deviation 398^-1/2.
    assert fit.along(np.array([1.0, 1.0])) == pytest.approx((1.0, 398**-0.5))
    assert fit.gain(np.array([1.0, 1.0])) == pytest.approx(199.0)
    assert fit.gain(np.array([1.0, 0.0])) == pytest.approx(199.5**2 / 200)
    assert fit.total == pytest.approx(0.5 * (1.5 * 199.5 + 0.5 * 198.5))
    assert fit.gain(np.zeros(2)) == 0.0


def test_directions_are_of_effects_and_of_what_no_effect_is():
    engine = mujoco(1)
    library = Library(None, engine.declared, realises=engine.realises)
    names = [*engine.declared]
    found = {way.name: way for way in directions(library, engine.declared)}
    grip = found["tire_grip"].direction
    moved = {names[i] for i in np.flatnonzero(grip)}
    assert moved == {"grip_front", "grip_rear"}
    # One prior scale of the factor, times 0.9, in shares of the range of 1.4.
    size = found["tire_grip"].number.size
    assert grip[names.index("grip_front")] == pytest.approx(0.9 * size / 1.4, rel=1e-4)
    assert {"payload", "steering_lag", "parameter:yaw_inertia"} <= {*found}
    assert "parameter:mass" not in found


def test_a_car_that_runs_away_is_far_off_and_no_crash(drives, monkeypatch):
    simulation = Simulation(lambda cars: make_engine("single_track", cars))
    monkeypatch.setattr(Simulation, "residuals", lambda *_: torch.full((1, 2, 3, 6), float("nan")))
    [residual] = Residuals(simulation, None, [])(np.array([0.5]), None)[0]
    assert np.isfinite(residual).all()
    assert residual.min() > 100


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
