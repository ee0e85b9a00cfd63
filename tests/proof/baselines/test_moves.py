"""What it says that parameters moved."""

import pytest

from buggy_rl.estimation.hypothesis import Library
from buggy_rl.proof.baselines.retune import Move, farthest
from buggy_rl.simulators import make_engine

OWN = Library([], make_engine("single_track", 1).declared).parameters


def test_the_farthest_certain_move_is_named():
    moves = [
        Move(OWN["rear_grip"], -0.6, 0.1),
        Move(OWN["front_grip"], 0.2, 0.05),
        Move(OWN["left_angle"], 2.0, 3.0),  # within its own noise
        Move(OWN["right_angle"], 0.05, 0.001),  # certain, and too small to matter
    ]
    effect = farthest(moves)["effects"][0]
    assert effect["name"] == "parameter:rear_grip"
    # 0.9 - 0.6 * 0.18, the size being a fifth of the value
    assert effect["parameters"]["rear_grip"]["value"] == pytest.approx(0.792)
    assert effect["confidence"] == pytest.approx(0.6 / 0.8)


def test_a_parameter_that_is_an_effect_is_called_by_it_without_its_number():
    said = farthest([Move(OWN["steering_lag"], 1.5, 0.1)], "before")
    assert said["verdict"] == "wrong_parameters"
    assert said["effects"][0]["name"] == "steering_lag"
    assert said["effects"][0]["parameters"] == {}
    assert said["notes"] == ["before", "steering_lag is 0.078, not 0.06"]


def test_where_none_is_certain_the_farthest_is_named():
    said = farthest([Move(OWN["rear_grip"], 0.6, 2.0), Move(OWN["front_grip"], 0.2, 2.0)])
    assert said["effects"][0]["name"] == "parameter:rear_grip"


def test_where_nothing_moved_nothing_is_named():
    said = farthest([Move(OWN["rear_grip"], 0.09, 0.001)])
    assert (said["verdict"], said["effects"]) == ("no_mismatch", [])


@pytest.mark.parametrize(
    ("spread", "certain"), [(0.7, True), (0.8, False), (float("inf"), False), (float("nan"), False)]
)
def test_a_move_is_certain_beyond_two_of_its_standard_deviations(spread, certain):
    assert Move(OWN["rear_grip"], -1.5, spread).certain is certain
