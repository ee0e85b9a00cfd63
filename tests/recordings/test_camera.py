import dataclasses

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.recordings.camera import Camera, CameraConfig, delayed

QUIET = CameraConfig(0.0, 0.0, 0.0, 0.0)


def ramp(rows=50):
    """Row k stands at x = k, y = 10 k, yaw = 0.1 and moves with (k, -k, 2)."""
    k = torch.arange(rows, dtype=torch.float32)
    constant = torch.ones(rows)
    return torch.stack([k, 10 * k, 0.1 * constant], -1), torch.stack([k, -k, 2 * constant], -1)


def test_a_perfect_camera_reports_the_truth():
    pose, velocity = ramp()
    measured = Camera(QUIET).measure(pose, velocity, 0.01)
    assert torch.equal(measured[0], pose)
    assert torch.equal(measured[1], velocity)


def test_noise_has_the_stated_deviation_no_mean_and_no_memory():
    still = torch.zeros(20000, 3)
    pose, velocity = Camera(CameraConfig(), seed=1).measure(still, still, 0.01)
    torch.testing.assert_close(pose.std(0), torch.tensor([7e-4, 7e-4, 2e-3]), rtol=0.03, atol=0)
    expected = torch.tensor([0.025, 0.025, 0.03])
    torch.testing.assert_close(velocity.std(0), expected, rtol=0.03, atol=0)
    assert (velocity.mean(0).abs() < 4 * expected / 20000**0.5).all()
    correlation = (velocity[1:] * velocity[:-1]).mean(0) / velocity.square().mean(0)
    assert correlation.abs().max() < 0.03


def test_one_seed_makes_one_noise_and_leaves_the_global_state_alone():
    still = torch.zeros(10, 2, 3)
    torch.manual_seed(5)
    first, second, other = (Camera(seed=s).measure(still, still, 0.01)[1] for s in (3, 3, 4))
    drawn = torch.rand(1)
    assert torch.equal(first, second)
    assert not torch.equal(first, other)
    torch.manual_seed(5)
    assert torch.equal(torch.rand(1), drawn)


def test_a_lever_arm_shows_the_motion_of_another_point_of_the_car():
    config = dataclasses.replace(QUIET, lever_arm_x=0.1, lever_arm_y=-0.05)
    pose = torch.tensor([[1.0, 2.0, torch.pi / 2]])
    measured, velocity = Camera(config).measure(pose, torch.tensor([[1.0, 0.0, 2.0]]), 0.01)
    # Facing +y, 0.1 ahead is +y and 0.05 to the right is +x: (1.05, 2.1).
    torch.testing.assert_close(measured, torch.tensor([[1.05, 2.1, torch.pi / 2]]))
    # vx - r y = 1 + 2 * 0.05 and vy + r x = 2 * 0.1
    torch.testing.assert_close(velocity, torch.tensor([[1.1, 0.2, 2.0]]))


@pytest.mark.parametrize(("latency", "rows"), [(0.03, 3.0), (0.015, 1.5), (0.0, 0.0)])
def test_latency_shows_an_earlier_row_and_the_first_one_before_that(latency, rows):
    pose, velocity = ramp()
    config = dataclasses.replace(QUIET, latency=latency)
    measured, _ = Camera(config).measure(pose, velocity, 0.01)
    expected = (torch.arange(50) - rows).clamp_min(0)
    torch.testing.assert_close(measured[:, 0], expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(measured[:, 1], 10 * expected, atol=1e-4, rtol=0)


def test_a_delay_of_half_a_row_is_the_mean_of_two():
    assert delayed(torch.tensor([[0.0], [2.0], [6.0]]), 0.5).flatten().tolist() == [0.0, 1.0, 4.0]


def test_dropped_frames_are_as_many_as_stated_and_never_the_first():
    kept = Camera(dataclasses.replace(QUIET, dropped_share=0.2), seed=2).arrived(10000)
    assert kept[0]
    assert 0.19 < 1 - kept.float().mean() < 0.21
    assert Camera(QUIET).arrived(100).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"yaw_noise": -0.1},
        {"latency": -1.0},
        {"lag": -0.1},
        {"speed_scale": 0.0},
        {"pose_scale": 0.0},
        {"dropped_share": 1.0},
    ],
)
def test_impossible_cameras_are_refused_by_name(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Camera(dataclasses.replace(QUIET, **wrong))


def test_a_turned_camera_reports_another_heading_and_another_course():
    pose = torch.tensor([[1.0, 2.0, 0.3]])
    config = dataclasses.replace(QUIET, yaw=0.1)
    measured, velocity = Camera(config).measure(pose, torch.tensor([[2.0, 0.0, 1.5]]), 0.01)
    torch.testing.assert_close(measured, torch.tensor([[1.0, 2.0, 0.4]]))
    # Turned to the left, it sees the car move ahead to its right: 2 cos 0.1, -2 sin 0.1.
    torch.testing.assert_close(velocity, torch.tensor([[1.9900, -0.1997, 1.5]]), atol=1e-4, rtol=0)


def test_a_map_of_another_scale_has_all_lengths_of_it():
    pose, velocity = ramp()
    config = dataclasses.replace(QUIET, pose_scale=0.9)
    measured, reported = Camera(config).measure(pose, velocity, 0.01)
    factor = torch.tensor([0.9, 0.9, 1.0])
    torch.testing.assert_close(measured, factor * pose)
    torch.testing.assert_close(reported, factor * velocity)


def test_a_drifting_heading_bends_the_path_from_its_first_row_on():
    # 0.02 m a row straight ahead, turned by 0.01 rad more from row to row: a circle of 2 m.
    rows = torch.arange(100.0)
    pose = torch.stack([1 + 0.02 * rows, 0 * rows, 0 * rows], -1)
    config = dataclasses.replace(QUIET, heading_drift=1.0)
    measured, reported = Camera(config).measure(pose, torch.ones(100, 3), 0.01)
    angle = 0.01 * rows
    circle = torch.stack([1 + 2 * angle.sin(), 2 * (1 - angle.cos()), angle], -1)
    torch.testing.assert_close(measured, circle, atol=1e-3, rtol=0)
    assert torch.equal(reported, torch.ones(100, 3))


def test_a_lagging_camera_follows_a_ramp_late_by_its_time_constant():
    config = dataclasses.replace(QUIET, lag=0.04)
    pose, velocity = ramp(200)
    measured, reported = Camera(config).measure(pose, velocity, 0.01)
    assert torch.equal(measured[0], pose[0])  # settled at the start
    # A ramp of 1 a row is 4 rows late once e^(-t / 0.04 s) is gone, whatever the rate of rows.
    late = torch.arange(200)[100:] - 4.0
    torch.testing.assert_close(measured[100:, 0], late, atol=1e-4, rtol=0)
    torch.testing.assert_close(reported[100:, 1], -late, atol=1e-4, rtol=0)
    torch.testing.assert_close(reported[:, 2], velocity[:, 2])
    # After 4 rows of the ramp it lacks 4 (1 - 1 / e) = 2.528 of them.
    assert float(pose[4, 0] - measured[4, 0]) == pytest.approx(2.528, abs=1e-3)


def test_scale_and_bias_are_of_the_reported_velocity_alone():
    pose, velocity = ramp()
    config = dataclasses.replace(QUIET, speed_scale=0.9, gyro_bias=-0.1)
    measured, reported = Camera(config).measure(pose, velocity, 0.01)
    assert torch.equal(measured, pose)
    expected = velocity * torch.tensor([0.9, 0.9, 1.0]) - torch.tensor([0.0, 0.0, 0.1])
    torch.testing.assert_close(reported, expected)


def test_a_recorded_drive_has_a_clock_and_segments_without_the_dropped_frames():
    pose, velocity = ramp(300)
    columns = {keys.POSE: pose, keys.VELOCITY: velocity, keys.ACTION: torch.zeros(300, 2)}
    camera = Camera(dataclasses.replace(QUIET, dropped_share=0.05), seed=1)
    recorded = camera.recorded(TensorDict(columns, [300]))
    row = recorded[keys.POSE][:, 0]  # row k stands at x = k
    torch.testing.assert_close(recorded[keys.TIME][:, 0], 0.01 * row.double())
    assert 5 < 300 - len(row) < 30
    gaps = row.diff() > 1
    assert torch.equal(recorded[keys.SEGMENT].diff() == 1, gaps)
    assert recorded[keys.SEGMENT][0] == 0
    assert gaps.any()
