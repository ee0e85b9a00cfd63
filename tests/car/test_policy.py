"""The runner's parts by hand-computed values; that it equals training is tested with the export."""

import math

import numpy as np
import pytest

from buggy_rl.car.path import Path
from buggy_rl.car.policy import COMPLETED, LEFT, Policy
from tests.car.runner import STRAIGHT, write_policy

REST = (0.0, 0.0, 0.0)
ROLLING = (0.5, 0.25, 0.0)


@pytest.fixture
def policy(tmp_path):
    """Makes a policy on a straight of 2 m, whose command is (vx, vy) unless told otherwise."""

    def make(closed=False, speed=None, **about):
        made = Policy.load(write_policy(tmp_path / "policy", **about))
        points = [(math.cos(a), math.sin(a)) for a in np.arange(8) * math.pi / 4]
        made.reset(Path(points if closed else STRAIGHT, closed), speed)
        return made

    return make


def test_the_command_is_that_of_the_network_within_its_limits(policy):
    assert policy().step(REST, ROLLING) == (0.5, 0.25)
    assert policy().step(REST, (7.0, -3.0, 0.0)) == (1.0, -1.0)


def test_the_layers_are_those_of_the_file(policy):
    weight = np.array([[2.0, 0, 0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0, 0, 0]])
    layers = [(weight, [0.0, 0.1]), (np.array([[0.5, 0.0], [0.0, 1.0]]), [-0.25, 0.5])]
    # vx = 0.4: relu(0.8, -0.3) = (0.8, 0), then (0.4 - 0.25, 0.5).
    assert policy(layers=layers).step(REST, (0.4, 0, 0)) == pytest.approx((0.15, 0.5))


def test_an_observation_is_standardised_and_cut_off(policy):
    mean, sd = np.float32([0.1] * 7), np.float32([0.01] * 7)
    made = policy(scaling=(mean, sd), layers=[(0.1 * np.eye(2, 7), np.zeros(2))])
    # (0.12 - 0.1) / 0.01 = 2; 0.5 is 40 sd off, cut off at 5.
    assert made.step(REST, (0.12, 0.5, 0)) == pytest.approx((0.2, 0.5), abs=1e-6)


def test_waypoints_are_seen_from_the_car(policy):
    made = policy()
    made.step((0.1, 0.3, math.pi / 2), REST)  # heading along y: ahead is y, left is -x
    seen = made.observation.waypoints
    np.testing.assert_allclose(seen, [[-0.3, -0.1], [-0.3, -0.3]], atol=1e-6)


def test_waypoints_close_in_a_row_and_not_in_the_first_step(policy):
    made = policy()
    made.step((0.5, 0.0, 0.0), REST)
    assert (made.waypoints.next, made.waypoints.closed) == (1, 0)
    made.step((0.5, 0.0, 0.0), REST)
    assert (made.waypoints.next, made.waypoints.closed) == (3, 2)  # those at 0.2 and 0.4 m
    made.step((1.9, 0.0, 0.0), REST)
    assert made.waypoints.next == 6  # three at once


def test_a_waypoint_too_far_beside_is_not_closed(policy):
    made = policy()
    for _ in range(2):
        made.step((0.5, 0.51, 0.0), REST)
    assert made.waypoints.next == 1


def test_the_end_of_an_open_path_is_said_and_of_a_closed_one_there_is_none(policy):
    made = policy()
    for x in np.arange(0, 2.2, 0.1):
        made.step((x, 0.0, 0.0), REST)
    assert made.ended == COMPLETED
    made = policy(closed=True)
    for angle in np.arange(0, 15, 0.1):
        made.step((math.cos(angle), math.sin(angle), angle + math.pi / 2), REST)
    # 14.9 rad of pi / 4 each are 18 waypoints and a part of the next.
    assert made.waypoints.next == 1 + 18
    assert made.ended == ""


def test_leaving_the_path_is_said_from_the_second_step_on(policy):
    made = policy()
    made.step((0.1, 1.01, 0.0), REST)
    assert made.ended == ""
    made.step((0.1, 1.01, 0.0), REST)
    assert made.ended == LEFT
    assert made.lateral_error == pytest.approx(1.01)
    made = policy(leave_path=None)
    for _ in range(2):
        made.step((0.1, 5.0, 0.0), REST)
    assert made.ended == ""


def test_the_past_mean_is_of_what_there_is(policy):
    made = policy(sensing=[{"name": "past_mean", "width": 3}])
    given = [made.step(REST, (value, 0, 0))[0] for value in (0.1, 0.3, 0.8, 0.4)]
    assert given == pytest.approx([0.1, 0.2, 0.4, 0.5])


def test_filters_stand_in_the_order_of_the_file(policy):
    clip = {"name": "clip_velocity", "low": [0.0] * 3, "high": [0.5] * 3}
    mean = {"name": "past_mean", "width": 2}
    clipped_first = policy(sensing=[clip, mean])
    mean_first = policy(sensing=[mean, clip])
    for made, expected in ((clipped_first, 0.3), (mean_first, 0.45)):
        made.step(REST, (0.1, 0, 0))
        assert made.step(REST, (0.8, 0, 0))[0] == pytest.approx(expected)


def test_smoothing_begins_at_no_drive_and_straight_wheels(policy):
    made = policy(commands=[{"name": "action_smoothing", "share": 0.5}])
    assert made.step(REST, (1.0, 1.0, 0)) == pytest.approx((0.0, 0.5))
    assert made.step(REST, (1.0, 1.0, 0)) == pytest.approx((0.5, 0.75))


def test_a_rate_limit_bounds_the_change_of_a_step(policy):
    made = policy(commands=[{"name": "rate_limit", "largest": [0.2, 0.1]}])
    assert made.step(REST, (1.0, -1.0, 0)) == pytest.approx((-0.8, -0.1))
    assert made.step(REST, (-0.7, 1.0, 0)) == pytest.approx((-0.7, 0.0))


def test_the_last_command_is_observed_and_forgotten_at_a_reset(policy):
    made = policy(
        observation={"inputs": ["last_action", "velocity"], "rows": 1},
        commands=[{"name": "last_action"}],
        layers=[(np.eye(2, 5) * 0.5, [0.0, 0.25])],
    )
    assert made.step(REST, REST) == (-0.5, 0.25)  # half of (-1, 0), plus (0, 0.25)
    assert made.step(REST, REST) == (-0.25, 0.375)
    made.reset(Path(STRAIGHT, False))
    assert made.step(REST, REST) == (-0.5, 0.25)


def test_what_acted_instead_is_observed_and_filtered_from(policy):
    made = policy(
        observation={"inputs": ["last_action"], "rows": 1},
        commands=[{"name": "last_action"}, {"name": "rate_limit", "largest": [0.2, 0.1]}],
        layers=[(np.eye(2), [0.5, 0.0])],
    )
    command = made.step(REST, REST)
    assert command == pytest.approx((-0.8, 0.0))  # asked -1 + 0.5, a step of 0.2 allowed
    made.acted(command)
    assert made.observation.values.tolist() == [-1.0, 0.0]
    # Its own command changes nothing: what is observed is what was asked, -0.5.
    assert made.step(REST, REST) == pytest.approx((-0.6, 0.0))
    assert made.observation.values[0] == pytest.approx(-0.5)
    made.acted((-0.9, 0.3))  # a cap, or a person
    assert made.step(REST, REST) == pytest.approx((-0.7, 0.3))  # asked -0.4, 0.3
    assert made.observation.values.tolist() == pytest.approx([-0.9, 0.3])


def test_history_begins_full_of_the_first_observation_and_is_oldest_first(policy):
    made = policy(observation={"inputs": ["target_speed"], "rows": 3}, commands=[],
                  target_speed={"low": 0.0, "high": 2.0}, layers=[(np.eye(2, 3), [0, 0])],
                  speed=0.75)  # fmt: skip
    made.step(REST, REST)
    assert made.observation.values.tolist() == [0.75] * 3
    made.target_speed = 0.25
    made.step(REST, REST)
    assert made.observation.values.tolist() == [0.75, 0.75, 0.25]


def test_a_target_speed_is_the_lowest_by_default_and_within_training(policy):
    about = {
        "observation": {"inputs": ["target_speed", "velocity"], "rows": 1},
        "target_speed": {"low": 0.25, "high": 2.0},
        "layers": [(np.eye(2, 4), [0, 0])],
    }
    assert policy(**about).step(REST, REST)[0] == 0.25
    with pytest.raises(ValueError, match=r"target_speed=3 m/s: trained in \[0\.25, 2\]"):
        policy(**about, speed=3.0)
    with pytest.raises(ValueError, match="trained without one"):
        policy(speed=1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_number_that_is_not_finite_is_refused_and_not_passed_on(policy, bad):
    for index in range(3):
        row = [0.0] * 3
        row[index] = bad
        with pytest.raises(ValueError, match="must be finite"):
            policy().step(row, REST)
        with pytest.raises(ValueError, match="must be finite"):
            policy().step(REST, row)


def test_a_path_comes_first(tmp_path):
    with pytest.raises(ValueError, match=r"before policy\.reset"):
        Policy.load(write_policy(tmp_path / "policy")).step(REST, REST)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"schema": 2}, r"policy\.json: schema is 2, this runtime reads 1"),
        ({"sensing": [{"name": "kalman"}]}, "sensing 'kalman'; known are clip_velocity, past_mean"),
        ({"commands": [{"name": "expo"}]}, "commands 'expo'; known are action_smoothing"),
        ({"network": {"activation": "gelu"}}, "activation 'gelu'"),
        ({"layers": [(np.eye(2, 9), [0, 0])]}, r"weight_0 is \[2, 9\], expected \[2, 7\]"),
        ({"layers": [(np.eye(3, 7), [0] * 3)]}, "3 outputs, expected throttle, steering"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path, about, message):
    with pytest.raises(ValueError, match=message):
        Policy.load(write_policy(tmp_path / "policy", **about))


def test_a_missing_half_of_the_pair_is_named(tmp_path):
    root = write_policy(tmp_path / "policy")
    (tmp_path / "policy.npz").unlink()
    with pytest.raises(ValueError, match=r"no policy file .*policy\.npz: write it with"):
        Policy.load(root)
