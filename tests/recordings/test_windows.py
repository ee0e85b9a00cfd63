import math

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.recordings.windows import mirror, model_inputs, relative_pose, windows
from tests.drives import counting_drive, toy_drive


def test_windows_hold_consecutive_rows_of_every_recording():
    cut = windows([counting_drive("a", 10), counting_drive("b", 7)], length=4, stride=3)
    assert cut[keys.ROW][:, 0].tolist() == [0, 3, 6, 0, 3]
    assert cut[keys.RECORDING][:, 0].tolist() == [0, 0, 0, 1, 1]
    assert cut[keys.VELOCITY][2, :, 0].tolist() == [6, 7, 8, 9]


def test_no_window_crosses_a_gap():
    cut = windows([counting_drive("a", 12, segments=[5])], length=4, stride=1)
    assert cut[keys.ROW][:, 0].tolist() == [0, 1, 5, 6, 7, 8]


def test_a_recording_too_short_for_a_window_is_named():
    with pytest.raises(ValueError, match="recordings short: no gap-free segment of 20 rows"):
        windows([counting_drive("short", 10)], length=20, stride=1)


def test_mirroring_flips_lateral_signs_and_twice_is_the_identity():
    data = windows([toy_drive("a", 60, 0)], 20, 20)
    flipped = mirror(data)
    signs = torch.tensor([1.0, -1.0, -1.0, 1.0, -1.0])
    assert_close(model_inputs(flipped), model_inputs(data) * signs)
    assert_close(model_inputs(mirror(flipped)), model_inputs(data), rtol=0, atol=0)


def test_a_mirrored_recording_is_still_consistent_with_its_own_motion():
    data = mirror(windows([toy_drive("a", 200, 1)], 200, 1))[0]
    pose, velocity = data[keys.POSE], data[keys.VELOCITY]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    assert_close(pose[1:, 2] - pose[:-1, 2], 0.01 * mean[:, 2], atol=1e-5, rtol=0)
    moved = relative_pose(torch.stack([pose[:-1], pose[1:]], 1))[:, 1, :2]
    assert_close(
        moved[:, 1], 0.01 * (mean[:, 1] + 0.005 * mean[:, 0] * mean[:, 2]), atol=1e-4, rtol=0
    )


def test_a_relative_pose_does_not_depend_on_the_world_frame():
    pose = torch.randn(5, 8, 3)
    angle = torch.tensor(0.7)
    cos, sin = math.cos(0.7), math.sin(0.7)
    turned = pose.clone()
    turned[..., 0] = cos * pose[..., 0] - sin * pose[..., 1] + 3
    turned[..., 1] = sin * pose[..., 0] + cos * pose[..., 1] - 2
    turned[..., 2] += angle
    assert_close(relative_pose(turned), relative_pose(pose), atol=1e-5, rtol=0)
