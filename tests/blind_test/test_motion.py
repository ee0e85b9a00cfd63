"""How the cars of cases are driven: richly or monotonously, each case by its own driver."""

import pytest
import torch

from buggy_rl import keys
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.motion import Ride, driven, moved
from buggy_rl.blind_test.steady_driver import SPEED, SteadyDriver
from buggy_rl.engines import make_engine
from buggy_rl.policies.controllers.room import RoomDriver

CARS, ROWS, SETTLED = 3, 1500, 300


def drive(driver):
    engine = make_engine("kinematic", CARS)
    return driven(engine, [Ride(driver(seed=4), slice(0, CARS))], ROWS)


@pytest.fixture(scope="module")
def steady():
    return drive(SteadyDriver)


def test_a_steady_driver_holds_one_speed(steady):
    speed = steady[keys.VELOCITY][:, SETTLED:, 0]
    # The driver believes in more friction than this car has.
    assert float(speed.median()) == pytest.approx(SPEED, abs=0.5)
    rich = drive(RoomDriver)[keys.VELOCITY][:, SETTLED:, 0]
    assert float(speed.std()) < 0.5 * float(rich.std())


def test_a_steady_driver_stays_in_the_room_and_does_not_jerk(steady):
    assert float(steady[keys.POSE][..., :2].abs().max()) < 4.0
    steering = steady[keys.ACTION][..., 1]
    # Away from the walls, where bends are wide; the slalom's fastest is 0.35 * 2 pi / 9 s.
    moved = steering.diff(dim=1).abs()
    assert float(moved.median()) < 0.35 * 2 * torch.pi / 9 * 0.01


def test_the_car_before_the_change_has_nothing_wrong_with_it():
    slow = {"throttle_gain": {"gain": 0.75}}
    cases = [
        Case(6, "reference", "mujoco_fitted", True, concealed, seconds=1.5)
        for concealed in ({}, slow)
    ]
    right, wrong = moved(cases)
    assert right.clean is not None
    assert wrong.clean is not None
    assert torch.equal(right.clean[keys.POSE], wrong.clean[keys.POSE])
    assert not torch.equal(right.changed[keys.POSE], wrong.changed[keys.POSE])
    assert moved([Case(6, "reference", "reference", seconds=1.0)])[0].clean is None


def test_baseline_drives_are_other_drives():
    motion = moved([Case(6, "reference", "mujoco_fitted", True, seconds=1.0)])[0]
    assert motion.clean is not None
    assert motion.changed.shape == (3, 100)
    assert motion.clean.shape == (2, 100)
    assert not torch.equal(motion.clean[keys.POSE], motion.changed[:2][keys.POSE])
