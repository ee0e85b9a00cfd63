import math

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import joined_paths
from buggy_rl.task.transforms.waypoints import Waypoints
from tests.task.transforms.cars import over_hold, place, square_path, start, step, straight_path


def standing(paths=None, batch_size=(), **options):
    """A car that goes where it is put, on waypoints at x = 0, 1, 2, ... unless others are given."""
    env = over_hold(Waypoints(paths or straight_path(), **options), batch_size=batch_size)
    return env, start(env)


def test_at_first_the_next_ten_waypoints_lie_ahead():
    _, state = standing()
    assert int(state[task.NEXT_WAYPOINT]) == 1
    expected = torch.stack([torch.arange(1.0, 11.0), torch.zeros(10)], -1)
    torch.testing.assert_close(state[task.WAYPOINTS], expected)


def test_waypoints_are_seen_from_the_car():
    env, state = standing()
    # At (0.5, 0.25), heading along y: waypoint (1, 0) is 0.25 m behind and 0.5 m to the right.
    seen = place(env, state, 0.5, 0.25, math.pi / 2)[task.WAYPOINTS]
    torch.testing.assert_close(seen[0], torch.tensor([-0.25, -0.5]))
    torch.testing.assert_close(seen[9], torch.tensor([-0.25, -9.5]))


@pytest.mark.parametrize(
    ("x", "y", "closed"),
    [
        (0.99, 0.0, 0),  # not there yet
        (1.00, 0.0, 0),  # on the line: (p - w) . t = 0 is not above 0
        (1.01, 0.0, 1),
        (1.01, 0.5, 1),  # as far beside it as the bound, either way
        (1.01, -0.5, 1),
        (1.01, 0.51, 0),
        (1.01, -0.51, 0),
        (-5.0, 0.0, 0),
    ],
)
def test_a_waypoint_closes_where_its_line_is_crossed_within_the_bound(x, y, closed):
    env, state = standing()
    after = place(env, state, x, y)
    assert float(after[task.WAYPOINTS_CLOSED]) == closed
    assert int(after[task.NEXT_WAYPOINT]) == 1 + closed
    assert after[task.WAYPOINTS].shape == (10, 2)


def test_a_car_is_set_down_about_the_start_as_far_as_asked():
    options = {"start_lateral": 0.2, "start_heading": 0.5}
    torch.manual_seed(0)
    _, state = standing(batch_size=(512,), **options)  # the path starts at 0, 0 along x
    x, y, yaw = state[keys.POSE].unbind(-1)
    torch.testing.assert_close(x, torch.zeros(512))
    for value, limit in ((y, 0.2), (yaw, 0.5)):
        assert 0.9 * limit < float(value.abs().max()) <= limit
        assert abs(float(value.mean())) < 0.1 * limit
    torch.testing.assert_close(state[task.LATERAL_ERROR][..., 0], y)


@pytest.mark.parametrize("bound", [0.1, 2.0])
def test_the_lateral_bound_can_be_chosen(bound):
    env, state = standing(lateral_bound=bound)
    assert float(place(env, state, 1.01, bound - 0.01)[task.WAYPOINTS_CLOSED]) == 1
    assert float(place(env, state, 1.01, bound + 0.01)[task.WAYPOINTS_CLOSED]) == 0


def test_the_line_is_normal_to_the_path_not_to_the_car():
    env, _ = standing(square_path())
    # Waypoint 4 is the corner (4, 0), between (3, 0) and (4, 1): its tangent is (1, 1) / sqrt 2.
    state = start(env, pose=(3.5, 0.0, 0.0), path=[0], next_waypoint=[4])
    # (3.8, 0.1): ((-0.2) + 0.1) / sqrt 2 < 0, although the car has not turned
    assert float(place(env, state, 3.8, 0.1)[task.WAYPOINTS_CLOSED]) == 0
    # (3.8, 0.3): ((-0.2) + 0.3) / sqrt 2 > 0; beside it by |-0.2 - 0.3| / sqrt 2 = 0.35 m
    assert float(place(env, state, 3.8, 0.3)[task.WAYPOINTS_CLOSED]) == 1
    # (3.6, 0.5): beyond by 0.07 m, but beside it by 0.9 / sqrt 2 = 0.64 m
    assert float(place(env, state, 3.6, 0.5)[task.WAYPOINTS_CLOSED]) == 0


def test_several_close_in_one_step_only_in_a_row():
    env, state = standing()
    # 2.5 m on, at once: waypoints 1 and 2
    after = place(env, state, 2.5, 0.0)
    assert float(after[task.WAYPOINTS_CLOSED]) == 2
    assert int(after[task.NEXT_WAYPOINT]) == 3
    # 8.5 m on: three are closed in a step, the next three in the following one
    after = place(env, state, 8.5, 0.0)
    assert float(after[task.WAYPOINTS_CLOSED]) == 3
    after = step(env, after)
    assert int(after[task.NEXT_WAYPOINT]) == 7


def test_a_waypoint_that_is_open_keeps_those_behind_it_open():
    env, _ = standing(square_path())
    # Next is (3, 0). At (4.3, 0.9) the car is beyond it but 0.9 m beside it, so it stays open, and
    # with it (4, 0) and (4, 1), whose lines the car has crossed, or nearly, and well within bounds.
    state = start(env, pose=(2.5, 0.0, 0.0), path=[0], next_waypoint=[3])
    after = place(env, state, 4.3, 1.1)
    assert float(after[task.WAYPOINTS_CLOSED]) == 0
    later = start(env, pose=(2.5, 0.0, 0.0), path=[0], next_waypoint=[5])
    assert float(place(env, later, 4.3, 1.1)[task.WAYPOINTS_CLOSED]) == 1


def test_a_car_that_drives_on_closes_each_once():
    env = over_hold(Waypoints(straight_path(60)))
    state = start(env, velocity=(50.0, 0.0, 0.0))  # half a metre each 10 ms
    closed = []
    for _ in range(20):
        state = step(env, state)
        closed.append(int(state[task.WAYPOINTS_CLOSED]))
    # at x = 0.5, 1.0, 1.5, ...: the line x = 1 is crossed at 1.5, x = 2 at 2.5
    assert closed == [0, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0]
    assert int(state[task.NEXT_WAYPOINT]) == 1 + sum(closed)


def test_a_car_that_drives_backwards_closes_nothing():
    env = over_hold(Waypoints(straight_path()))
    state = start(env, velocity=(-100.0, 0.0, 0.0))
    for _ in range(5):
        state = step(env, state)
        assert float(state[task.WAYPOINTS_CLOSED]) == 0


def test_a_missed_waypoint_can_still_be_closed():
    env, state = standing()
    state = place(env, state, 1.5, 0.8)
    assert int(state[task.NEXT_WAYPOINT]) == 1
    assert int(place(env, state, 1.6, 0.3)[task.NEXT_WAYPOINT]) == 2


def test_a_closed_path_never_ends():
    paths = square_path()
    env = over_hold(Waypoints(paths))
    state = start(env)
    closed = 0
    for lap in range(3):
        for k in range(1, 17):  # the 16 waypoints of a lap, each 20 cm beyond its line
            w, t = paths.points[0, k % 16], paths.tangents()[0, k % 16]
            x, y = (w + 0.2 * t).tolist()
            state = place(env, state, x, y)
            closed += int(state[task.WAYPOINTS_CLOSED])
            assert int(state[task.NEXT_WAYPOINT]) == 16 * lap + k + 1
            assert not state[task.COMPLETED]
    assert closed == 48
    # after three laps the car stands by waypoint 0; what it sees begins at waypoint 1 = (1, 0)
    x, y = state[keys.POSE][:2].tolist()
    expected = paths.extended(1)[0, 1:11] - torch.tensor([x, y])
    torch.testing.assert_close(state[task.WAYPOINTS], expected, atol=1e-6, rtol=0)
    # three laps of 16 m, and 0.2 m along the diagonal tangent: 0.14 m along the next side
    position = float(state[task.PATH_POSITION])
    assert position == pytest.approx(48.0 + 0.2 / math.sqrt(2), abs=1e-4)


def test_an_open_path_is_complete_when_its_last_waypoint_is_closed():
    env, state = standing(straight_path(count=5), at_once=1)  # the last is x = 4
    for x in (1.1, 2.1, 3.1):
        state = place(env, state, x, 0.0)
        assert not state[task.COMPLETED]
    # the queue has shown what would come if the path went on straight
    torch.testing.assert_close(state[task.WAYPOINTS][:, 0], torch.arange(4.0, 14.0) - 3.1)
    state = place(env, state, 4.1, 0.0)
    assert state[task.COMPLETED]
    for _ in range(3):  # whatever is beyond does not count
        state = place(env, state, 9.0, 0.0)
        assert float(state[task.WAYPOINTS_CLOSED]) == 0
        assert state[task.COMPLETED]
        assert int(state[task.NEXT_WAYPOINT]) == 5


def test_no_more_close_at_once_than_the_path_has():
    env, state = standing(straight_path(count=5))
    state = place(env, state, 3.5, 0.0)
    state = place(env, state, 8.5, 0.0)
    assert float(state[task.WAYPOINTS_CLOSED]) == 1  # x = 4 alone
    assert state[task.COMPLETED]


def test_lateral_and_heading_error_are_positive_to_the_left():
    env, state = standing()
    left = place(env, state, 0.5, 0.3, 0.2)
    torch.testing.assert_close(left[task.LATERAL_ERROR], torch.tensor([0.3]))
    torch.testing.assert_close(left[task.HEADING_ERROR], torch.tensor([0.2]))
    right = place(env, state, 0.5, -0.3, -0.2 + 4 * math.pi)
    torch.testing.assert_close(right[task.LATERAL_ERROR], torch.tensor([-0.3]))
    torch.testing.assert_close(right[task.HEADING_ERROR], torch.tensor([-0.2]), atol=1e-5, rtol=0)


def test_the_distance_is_from_the_piece_before_the_next_waypoint():
    env, state = standing()
    # Next is x = 1, the piece from 0 to 1. Behind it by 0.3 and beside it by 0.4: 0.5 m away.
    behind = place(env, state, -0.3, -0.4)
    torch.testing.assert_close(behind[task.LATERAL_ERROR], torch.tensor([-0.5]))
    # A car that passed too far beside, at 0.6 m, gets away from it as it drives on: 3-4-5.
    missed = place(env, state, 1.8, 0.6)
    torch.testing.assert_close(missed[task.LATERAL_ERROR], torch.tensor([1.0]))


def test_the_position_along_the_path_grows_with_the_way():
    env, state = standing()
    positions = [float(place(env, state, x, 0.1)[task.PATH_POSITION]) for x in (0.0, 0.4, 0.9)]
    assert positions == pytest.approx([0.0, 0.4, 0.9], abs=1e-6)
    lap = make_paths(PathConfig(kind="lap"))
    env = over_hold(Waypoints(lap))
    # halfway round, at waypoint 25 of 51, by chords: 25 of them, each 0.2013 m or a little less
    x, y = lap.points[0, 25].tolist()
    state = start(env, pose=(x, y, math.pi), path=[0], next_waypoint=[26])
    chords = lap.extended(0)[0, :26].diff(dim=0).norm(dim=-1).sum()
    assert float(state[task.PATH_POSITION]) == pytest.approx(float(chords), abs=1e-5)


def test_the_measured_pose_is_what_is_seen_and_the_true_one_what_counts():
    waypoints = Waypoints(straight_path())
    env = over_hold(waypoints)
    state = place(env, start(env), 1.1, 0.0)
    state[task.MEASURED_POSE] = torch.tensor([0.6, 0.0, 0.0])
    path, following = state[task.PATH], torch.ones_like(state[task.PATH])
    shown = waypoints._write(state, path, following, torch.zeros_like(following))
    torch.testing.assert_close(shown[task.WAYPOINTS][0], torch.tensor([0.4, 0.0]))
    torch.testing.assert_close(shown[task.LATERAL_ERROR], torch.tensor([0.1]))  # beyond x = 1


def several():
    paths = make_paths(PathConfig(count=5, waypoints=40))
    return joined_paths([paths, make_paths(PathConfig(kind="lap")), straight_path()])


def test_each_car_follows_its_own_path():
    paths = several()
    env = over_hold(Waypoints(paths, order="fixed"), batch_size=(7,))
    state = start(env)
    assert state[task.PATH].flatten().tolist() == list(range(7))
    torch.testing.assert_close(state[task.WAYPOINTS], paths.points[:, 1:11])
    for car, batched in enumerate(state[task.WAYPOINTS]):
        lone = over_hold(Waypoints(paths))
        torch.testing.assert_close(start(lone, path=[car])[task.WAYPOINTS], batched)


def test_fixed_order_begins_again_after_the_last_path():
    env = over_hold(Waypoints(several(), order="fixed"), batch_size=(2, 5))
    expected = [[0, 1, 2, 3, 4], [5, 6, 0, 1, 2]]
    assert start(env)[task.PATH].squeeze(-1).tolist() == expected


def test_random_order_takes_every_path_about_as_often_and_follows_the_seed():
    env = over_hold(Waypoints(several()), batch_size=(7000,))
    torch.manual_seed(0)
    first = start(env)[task.PATH]
    counts = first.flatten().bincount(minlength=7)
    # binomial of 7000 with 1/7: sd 29; five of them
    assert ((counts - 1000).abs() < 145).all()
    assert not torch.equal(start(env)[task.PATH], first)
    torch.manual_seed(0)
    assert torch.equal(start(env)[task.PATH], first)


def test_a_reset_puts_the_car_at_the_start_of_its_path():
    paths = make_paths(PathConfig(count=6, waypoints=40, placed=True))
    env = over_hold(Waypoints(paths), batch_size=(50,))
    state = env.reset()
    assert torch.equal(state[keys.POSE], paths.start[state[task.PATH].squeeze(-1)])
    assert state[task.LATERAL_ERROR].abs().max() < 1e-5
    assert state[task.HEADING_ERROR].abs().max() < 0.17  # rad, of a turn's first piece
    assert (state[task.WAYPOINTS][:, 0, 0] > 0.19).all()


def test_a_reset_of_some_cars_gives_only_them_a_new_path():
    torch.manual_seed(1)
    env = over_hold(Waypoints(several()), batch_size=(40,))
    state = start(env, velocity=(40.0, 0.0, 0.0))
    for _ in range(3):
        state = step(env, state)
    mask = (torch.arange(40) % 2 == 0)[:, None]
    asked = state.select(*env.done_keys).set("_reset", mask)
    kept = state.clone()
    after = env.reset(state.clone().update(asked), select_reset_only=True)
    for key in (task.PATH, task.NEXT_WAYPOINT, task.WAYPOINTS, keys.POSE, task.LATERAL_ERROR):
        assert torch.equal(after[key][~mask[:, 0]], kept[key][~mask[:, 0]]), key
    assert (after[task.NEXT_WAYPOINT][mask] == 1).all()
    assert not after[keys.POSE][mask[:, 0]].any()
    assert (after[task.PATH][mask] != kept[task.PATH][mask]).any()


def test_an_unknown_order_is_refused():
    with pytest.raises(ValueError, match="order is 'sorted': must be random or fixed"):
        Waypoints(straight_path(), order="sorted")  # type: ignore[arg-type]
