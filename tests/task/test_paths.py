import math
from dataclasses import replace

import numpy as np
import opensimplex
import pytest
import torch

from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import PathSet, equal_paths, joined_paths
from buggy_rl.task.paths.shapes import pursue, simplex_noise

SMALL = PathConfig(count=8, validation_count=4, waypoints=120)
KINDS = ("simplex", "lap", "infinity", "circle", "tight")


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_leaves_the_origin_along_x(kind):
    paths = make_paths(replace(SMALL, kind=kind))
    assert not paths.points[:, 0].any()
    assert not paths.start.any()
    # the first waypoint is on a turn of no less than 0.6 m: 0.2^2 / (2 * 0.6) = 33 mm beside x
    assert (paths.points[:, 1, 0] > 0.19).all()
    assert (paths.points[:, 1, 1].abs() < 0.034).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("spacing", [0.1, 0.2, 0.5])
def test_waypoints_are_a_spacing_apart(kind, spacing):
    paths = make_paths(replace(SMALL, kind=kind, spacing=spacing, count=3))
    steps = paths.extended(1).diff(dim=1).norm(dim=-1)
    # closed paths take the nearest spacing that fits; chords are shorter than arcs, by
    # (0.5 / 0.6)^2 / 24 = 3 % of the widest here; together within 7 %
    assert ((steps / spacing - 1).abs() < 0.07).all()


def test_a_lap_is_two_straights_and_two_half_circles():
    lap = make_paths(PathConfig(kind="lap", straight=2.0, radius=1.0, spacing=0.2))
    # length 2 * 2 + 2 pi = 10.28 m; 10.28 / 0.2 = 51.4 waypoints
    assert lap.count.tolist() == [51]
    x, y = lap.points[0].unbind(-1)
    from_middle = torch.hypot(x - x.clamp(0, 2), y - 1)  # of the stadium, whose axis is y = 1
    torch.testing.assert_close(from_middle, torch.ones(51), atol=1e-5, rtol=0)
    assert float(lap.largest_curvature) == pytest.approx(1.0, abs=1e-4)


def test_infinity_is_a_circle_to_the_left_and_one_to_the_right():
    points = make_paths(PathConfig(kind="infinity", radius=1.5)).points[0]
    centre = torch.where(points[:, 1:] >= 0, 1.5, -1.5)
    distance = torch.hypot(points[:, 0], points[:, 1] - centre[:, 0])
    torch.testing.assert_close(distance, torch.full_like(distance, 1.5), atol=1e-5, rtol=0)
    half = len(points) // 2
    assert (points[1:half, 1] > 0).all()
    assert (points[half + 1 :, 1] < 0).all()


def test_the_curvature_of_a_circle_is_one_over_its_radius():
    paths = make_paths(PathConfig(kind="circle", radius=2.0))
    assert float(paths.largest_curvature) == pytest.approx(0.5, abs=1e-4)


def test_random_paths_turn_no_tighter_than_asked():
    assert (make_paths(SMALL).largest_curvature < 1 / 0.6 + 1e-3).all()
    wide = make_paths(replace(SMALL, sharpest_radius=1.5))
    assert (wide.largest_curvature < 1 / 1.5 + 1e-3).all()
    raw = make_paths(replace(SMALL, sharpest_radius=0.0))
    assert raw.largest_curvature.max() > 3.0  # the noise itself has cusps


def test_random_paths_keep_to_their_room():
    # The noise may fill the room; the chase swings out of it by less than a turn.
    for room in (10.0, 20.0):
        points = make_paths(replace(SMALL, room=room)).points
        extent = (points.amax(1) - points.amin(1)).amax()
        assert room / 3 < extent < math.sqrt(2) * room


def test_the_tight_path_fits_an_8_m_room_and_turns_both_ways():
    points = make_paths(PathConfig(kind="tight")).points[0]
    assert (points.amax(0) - points.amin(0) < 5.0).all()
    step = points.diff(dim=0)
    heading = torch.atan2(step[:, 1], step[:, 0])
    turn = torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi
    assert turn.clamp_min(0).sum() > math.pi
    assert turn.clamp_max(0).sum() < -math.pi


def test_training_and_validation_share_no_path():
    training, validation = make_paths(SMALL), make_paths(replace(SMALL, part="validation"))
    assert (len(training), len(validation)) == (8, 4)
    everything = torch.cat([training.points, validation.points]).flatten(1)
    nearest = torch.cdist(everything, everything).fill_diagonal_(math.inf).min()
    # two different paths of 120 waypoints are metres apart; one drawn twice would give 0
    assert nearest > 10.0
    # Another seed or another count of the one does not make it run into the other.
    later = make_paths(replace(SMALL, seed=1, count=12)).points.flatten(1)
    assert torch.cdist(later, everything).min() > 10.0


def test_selection_shares_no_path_with_training_and_validation():
    parts = {p: make_paths(replace(SMALL, part=p)) for p in ("training", "validation", "selection")}
    chosen = parts.pop("selection").points.flatten(1)
    assert len(chosen) == 4
    for other in parts.values():
        assert torch.cdist(chosen, other.points.flatten(1)).min() > 10.0


def test_waypoints_are_wider_apart_where_a_random_path_is_straight():
    paths = make_paths(replace(SMALL, straight_spacing=0.4))
    steps = paths.points.diff(dim=1)
    length, yaw = steps.norm(dim=-1), torch.atan2(steps[..., 1], steps[..., 0])
    turn = torch.remainder(yaw.diff(dim=-1) + math.pi, 2 * math.pi) - math.pi
    bend = turn.abs() / length[:, 1:]  # [1/m]
    straight, sharp = length[:, 1:][bend < 0.05], length[:, 1:][bend > 1.4]
    # one row of the chase, 0.05 m, is the resolution
    torch.testing.assert_close(straight.median(), torch.tensor(0.4), atol=0.05, rtol=0)
    torch.testing.assert_close(sharp.median(), torch.tensor(0.2), atol=0.05, rtol=0)
    assert length.min() > 0.14
    assert length.max() < 0.46


def test_a_spacing_on_straights_below_that_in_turns_is_refused():
    with pytest.raises(ValueError, match=r"straight_spacing is 0\.1: must not be below spacing"):
        make_paths(replace(SMALL, straight_spacing=0.1))


def test_a_seed_fixes_the_paths_whatever_their_number():
    make_paths.cache_clear()
    first = make_paths(SMALL)
    make_paths.cache_clear()
    assert torch.equal(make_paths(SMALL).points, first.points)
    assert torch.equal(make_paths(replace(SMALL, count=5)).points, first.points[:5])


def test_noise_is_the_librarys_to_the_last_bit():
    # 500 places a seed: on both sides of the origin, in both triangles of some 500 cells
    generator = np.random.default_rng(0)
    seeds = [0, 7, 2**62 + 11]
    x, y = generator.uniform(-60.0, 60.0, (2, 3, 500))
    expected = [
        [opensimplex.OpenSimplex(seed).noise2(*place) for place in zip(*rows, strict=True)]
        for seed, *rows in zip(seeds, x[:, :100], y[:, :100], strict=True)
    ]
    noise = simplex_noise(seeds, x, y)
    assert np.array_equal(noise[:, :100], np.array(expected))
    assert np.abs(noise).max() <= 1.0
    assert noise.std() > 0.2


def test_random_paths_turn_left_as_often_as_right():
    ends = make_paths(replace(SMALL, count=150, waypoints=15)).points[:, -1]
    share = float((ends[:, 1] > 0).float().mean())
    # binomial of 150: sd 0.041; four of them
    assert share == pytest.approx(0.5, abs=0.165)


def test_a_chaser_follows_a_straight_target_straight():
    target = np.zeros((1, 500, 2))
    target[0, :, 0] = np.arange(500) * 0.05
    track = pursue(target, step=0.05, radius=0.6, rows=400)
    np.testing.assert_allclose(track, target[:, :400], atol=1e-9)


def test_a_closed_path_goes_on_from_its_last_waypoint_to_its_first():
    lap = make_paths(PathConfig(kind="lap"))
    assert torch.equal(lap.extended(60)[:, 51:102], lap.points)
    assert torch.equal(lap.before()[:, 0], lap.points[:, -1])
    # along x at the start, which is the middle of a straight and an arc: half a step's turn
    assert float(lap.tangents()[0, 0, 0]) == pytest.approx(1.0, abs=0.01)


def test_an_open_path_goes_on_straight():
    points = np.stack([np.arange(5.0), np.zeros(5)], -1)[None]
    path = equal_paths(["five"], points, closed=False)
    expected = torch.tensor([[5.0, 0.0], [6.0, 0.0], [7.0, 0.0]])
    torch.testing.assert_close(path.extended(3)[0, 5:], expected)
    torch.testing.assert_close(path.before()[0, 0], torch.tensor([-1.0, 0.0]))


def test_a_mirrored_set_holds_every_path_twice():
    paths = make_paths(replace(SMALL, mirrored=True))
    assert len(paths) == 16
    torch.testing.assert_close(paths.points[8:], paths.points[:8] * torch.tensor([1.0, -1.0]))


def test_placed_paths_are_the_same_paths_elsewhere():
    placed, plain = make_paths(replace(SMALL, placed=True)), make_paths(SMALL)
    assert (placed.start[:, :2].abs() <= 10.0).all()
    assert placed.start.std(0).min() > 1.0
    torch.testing.assert_close(placed.points[:, 0], placed.start[:, :2])
    away = (placed.points[:, 1:] - placed.points[:, :1]).norm(dim=-1)
    torch.testing.assert_close(away, plain.points[:, 1:].norm(dim=-1), atol=1e-4, rtol=0)
    first = placed.points[:, 1] - placed.points[:, 0]
    towards = torch.atan2(first[:, 1], first[:, 0]) - placed.start[:, 2]
    assert (torch.sin(towards).abs() < 0.17).all()  # it leaves along its start's yaw


def test_sets_of_different_lengths_join_without_mixing():
    lap, tight = (make_paths(PathConfig(kind=kind)) for kind in ("lap", "tight"))
    both = joined_paths([lap, tight])
    assert both.names == ("lap", "tight")
    assert both.count.tolist() == [51, 120]
    for index, one in enumerate((lap, tight)):
        assert torch.equal(both.extended(70)[index, :160], one.extended(160)[0, :160])
    torch.testing.assert_close(
        both.largest_curvature, torch.cat([lap.largest_curvature, tight.largest_curvature])
    )


def test_a_file_becomes_a_path_from_the_origin(tmp_path):
    file = tmp_path / "corner.csv"
    # 3 m north from (1, 1), then 1 m west: from the origin 3 m along x, then 1 m to the left
    file.write_text("x,y\n1,1\n1,4\n0,4\n")
    path = make_paths(PathConfig(kind="file", file=str(file), spacing=0.5))
    expected = [[0, 0], [0.5, 0], [1, 0], [1.5, 0], [2, 0], [2.5, 0], [3, 0], [3, 0.5], [3, 1]]
    torch.testing.assert_close(path.points[0], torch.tensor(expected, dtype=torch.float32))
    assert not path.closed
    assert path.names == ("corner",)


def test_a_file_whose_last_row_is_its_first_closes(tmp_path):
    file = tmp_path / "square.csv"
    file.write_text("x,y\n0,0\n2,0\n2,2\n0,2\n0,0\n")
    path = make_paths(PathConfig(kind="file", file=str(file), spacing=0.5))
    assert path.closed
    assert path.count.tolist() == [16]
    torch.testing.assert_close(path.extended(1)[0, 16], torch.zeros(2))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x,y\n0,0\n1,nan\n2,0\n", "row 3: x, y are 1.*nan"),
        ("x,y\n0,0\n1,left\n2,0\n", "row 3: x, y are 1.*left"),
        ("a,b\n0,0\n", "has columns a, b: it needs x and y"),
        ("x,y\n0,0\n0.1,0\n0.2,0\n", "two spacings"),
        ("x,y\n0,0\n3,0\n0,0\n", "'track' turns back on itself at waypoint 0"),
    ],
)
def test_a_file_that_is_no_path_is_refused(tmp_path, content, message):
    file = tmp_path / "track.csv"
    file.write_text(content)
    with pytest.raises(ValueError, match=message):
        make_paths(PathConfig(kind="file", file=str(file)))


def test_a_path_with_a_repeated_point_is_refused_by_row():
    points = np.stack([np.arange(8.0), np.zeros(8)], -1)[None]
    points[0, 5:, 0] -= 1.0  # 0 1 2 3 4 4 5 6
    with pytest.raises(ValueError, match="'twice': waypoints 4 and 5 are 0 m apart"):
        equal_paths(["twice"], points, closed=False)


def test_a_path_that_is_not_finite_is_refused_by_row():
    points = torch.zeros(1, 8, 2)
    points[0, :, 0] = torch.arange(8.0)
    points[0, 6, 1] = math.inf
    with pytest.raises(ValueError, match="'far': waypoint 6 is not finite"):
        PathSet(points, torch.tensor([8]), torch.tensor([False]), torch.zeros(1, 3), ("far",))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spacing": 0.0}, "spacing is 0.0"),
        ({"count": 0}, "count is 0"),
        ({"sharpest_radius": -1.0}, "sharpest_radius is -1.0"),
        ({"kind": "loop"}, "no path 'loop'; available: simplex, lap"),
        ({"kind": "file", "file": "nowhere.csv"}, "no path file 'nowhere.csv'"),
    ],
)
def test_a_wrong_config_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        make_paths(replace(SMALL, **change))
