import pytest
import torch
from torchrl.envs import StepCounter

from buggy_rl.core import keys
from buggy_rl.task.transforms.rewards import LeavePath, PathEnd
from buggy_rl.task.transforms.waypoints import Waypoints
from tests.task.transforms.cars import over_hold, place, start, step, straight_path


def on_path(count=30, batch_size=(), max_steps=1000):
    waypoints = Waypoints(straight_path(count))
    ends = (LeavePath(limit=1.0), PathEnd(), StepCounter(max_steps=max_steps))
    env = over_hold(waypoints, *ends, batch_size=batch_size)
    return env, start(env)


def flags(state):
    return tuple(bool(state[key]) for key in (keys.TERMINATED, keys.TRUNCATED, keys.DONE))


@pytest.mark.parametrize("side", [1, -1])
def test_leaving_the_path_terminates_and_does_not_truncate(side):
    env, state = on_path()
    assert flags(place(env, state, 0.5, side * 0.99)) == (False, False, False)
    assert flags(place(env, state, 0.5, side * 1.01)) == (True, False, True)


def test_the_end_of_the_path_truncates_and_does_not_terminate():
    env, state = on_path(count=4)
    state = place(env, state, 2.5, 0.0)
    assert flags(state) == (False, False, False)
    assert flags(place(env, state, 3.1, 0.0)) == (False, True, True)


def test_the_step_limit_truncates_and_does_not_terminate():
    env, state = on_path(max_steps=2)
    state = step(env, state)
    assert flags(state) == (False, False, False)
    assert flags(step(env, state)) == (False, True, True)


def test_a_car_may_leave_the_path_in_its_last_step():
    env, state = on_path(max_steps=1)
    assert flags(place(env, state, 0.5, 5.0)) == (True, True, True)


def test_a_car_that_passed_a_waypoint_too_far_beside_it_leaves_the_path_driving_on():
    env, state = on_path()
    for x, left in ((1.2, False), (1.7, False), (2.0, True)):  # 0.6 m beside: 0.8^2 + 0.6^2 = 1
        state = place(env, state, x, 0.61)
        assert flags(state)[0] is left


def test_after_a_reset_nothing_is_over():
    env, state = on_path(batch_size=(4,), max_steps=3)
    state["step_count"] = torch.tensor([[0], [2], [0], [0]])
    state[keys.POSE] = torch.tensor([[0.5, 0, 0], [0.5, 0, 0], [0.5, 3.0, 0], [0.5, 0, 0]])
    state[keys.ACTION] = torch.zeros(4, 2)
    data, state = env.step_and_maybe_reset(state)
    assert data["next", keys.TRUNCATED].flatten().tolist() == [False, True, False, False]
    assert data["next", keys.TERMINATED].flatten().tolist() == [False, False, True, False]
    for key in (keys.TERMINATED, keys.TRUNCATED, keys.DONE):
        assert not state[key].any()
    assert state["step_count"].flatten().tolist() == [1, 0, 0, 1]
    # what is recorded is where they ended, what goes on is where they begin
    assert data["next", keys.POSE][:, 1].tolist() == [0.0, 0.0, 3.0, 0.0]
    assert state[keys.POSE][:, 0].tolist() == [0.5, 0.0, 0.0, 0.5]


def test_a_limit_of_nothing_is_refused():
    with pytest.raises(ValueError, match=r"limit is 0.0 m"):
        LeavePath(limit=0.0)
