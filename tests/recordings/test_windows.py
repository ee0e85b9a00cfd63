import math

import pytest
import torch
from torch.testing import assert_close

from buggy_rl import keys
from buggy_rl.recordings.windows import (
    centred_mean,
    filtered,
    mirror,
    model_inputs,
    past_mean,
    relative_pose,
    split,
    windows,
)
from tests.drives import counting_drive, toy_drive


def test_windows_hold_consecutive_rows_of_every_drive():
    cut = windows([counting_drive("a", 10), counting_drive("b", 7)], length=4, stride=3)
    assert cut[keys.ROW][:, 0].tolist() == [0, 3, 6, 0, 3]
    assert cut[keys.RECORDING][:, 0].tolist() == [0, 0, 0, 1, 1]
    assert cut[keys.VELOCITY][2, :, 0].tolist() == [6, 7, 8, 9]


def test_no_window_crosses_a_gap():
    cut = windows([counting_drive("a", 12, segments=[5])], length=4, stride=1)
    assert cut[keys.ROW][:, 0].tolist() == [0, 1, 5, 6, 7, 8]


def test_a_drive_too_short_for_a_window_is_named():
    with pytest.raises(ValueError, match="no gap-free stretch of 20 rows in short"):
        windows([counting_drive("short", 10)], length=20, stride=1)


def test_past_mean_uses_the_past_alone():
    signal = torch.tensor([[0.0], [3.0], [6.0], [9.0]])
    # width 3: 0/1, (0+3)/2, (0+3+6)/3, (3+6+9)/3
    assert past_mean(signal, 3).flatten().tolist() == [0.0, 1.5, 3.0, 6.0]
    changed = signal.clone()
    changed[3] = 100.0
    assert_close(past_mean(changed, 3)[:3], past_mean(signal, 3)[:3])


def test_centred_mean_keeps_a_straight_line_and_looks_ahead():
    line = torch.arange(9.0)[:, None]
    assert_close(centred_mean(line, 3)[1:-1], line[1:-1])
    with pytest.raises(ValueError, match="odd"):
        centred_mean(line, 4)


def test_filtering_does_not_reach_across_a_gap():
    drive = filtered(counting_drive("a", 10, segments=[5]), 5)
    assert drive.data[keys.VELOCITY][5, 0] == 5.0


def test_filtering_leaves_the_original_drive_alone():
    drive = counting_drive("a", 10)
    filtered(drive, 5)
    assert drive.data[keys.VELOCITY][:, 0].tolist() == list(range(10))


def test_mirroring_flips_what_points_left_and_twice_is_nothing():
    data = windows([toy_drive("a", 60, 0)], 20, 20)
    flipped = mirror(data)
    signs = torch.tensor([1.0, -1.0, -1.0, 1.0, -1.0])
    assert_close(model_inputs(flipped), model_inputs(data) * signs)
    assert_close(model_inputs(mirror(flipped)), model_inputs(data), rtol=0, atol=0)


def test_a_mirrored_drive_is_still_consistent_with_its_own_motion():
    data = mirror(windows([toy_drive("a", 200, 1)], 200, 1))[0]
    pose, velocity = data[keys.POSE], data[keys.VELOCITY]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    assert_close(pose[1:, 2] - pose[:-1, 2], 0.01 * mean[:, 2], atol=1e-5, rtol=0)
    moved = relative_pose(torch.stack([pose[:-1], pose[1:]], 1))[:, 1, :2]
    assert_close(
        moved[:, 1], 0.01 * (mean[:, 1] + 0.005 * mean[:, 0] * mean[:, 2]), atol=1e-4, rtol=0
    )


def test_a_relative_pose_does_not_depend_on_where_the_world_has_its_origin():
    pose = torch.randn(5, 8, 3)
    angle = torch.tensor(0.7)
    cos, sin = math.cos(0.7), math.sin(0.7)
    turned = pose.clone()
    turned[..., 0] = cos * pose[..., 0] - sin * pose[..., 1] + 3
    turned[..., 1] = sin * pose[..., 0] + cos * pose[..., 1] - 2
    turned[..., 2] += angle
    assert_close(relative_pose(turned), relative_pose(pose), atol=1e-5, rtol=0)


def test_a_split_keeps_drives_whole_and_does_not_depend_on_their_order():
    drives = [counting_drive(name, 5) for name in "abcdefgh"]
    training, held = split(drives, 0.25, seed=3)
    again = split(drives[::-1], 0.25, seed=3)[1]
    assert len(held) == 2
    assert {r.name for r in training} | {r.name for r in held} == set("abcdefgh")
    assert {r.name for r in held} == {r.name for r in again}


def test_holding_out_an_unknown_drive_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"\['z'\].*\['a', 'b'\]"):
        split([counting_drive("a", 5), counting_drive("b", 5)], ["z"])
