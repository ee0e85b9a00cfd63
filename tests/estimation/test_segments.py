import pytest
import torch

from buggy_rl.estimation.segments import WORKED, cut_segments, smoothing_rows
from tests.drives import counting_drive


def test_a_recording_is_cut_into_segments_of_its_own_rows():
    # 1.0 s is 30 + 100 + 1 = 131 rows; of 400 rows 131 fit at 0, 100 and 200 (till 330), not 300.
    segments = cut_segments([counting_drive("a", 130), counting_drive("b", 400)], 1.0, 1.0)
    assert len(segments) == 3
    assert segments.horizon == 100
    assert segments.row.tolist() == [0, 100, 200]
    assert segments.recording.tolist() == [1, 1, 1]  # the first is a row too short
    assert segments.velocity[:, segments.start, 0].tolist() == [30, 130, 230]
    assert segments.action[1, :, 1].tolist() == [-row for row in range(100, 231)]
    torch.testing.assert_close(segments.elapsed, torch.tensor([0.0, 1.0, 2.0]))
    part = segments[torch.tensor([2])]
    assert len(part) == 1
    assert part.row.tolist() == [200]
    assert part.dt == segments.dt


def test_no_segment_crosses_a_gap():
    # Gap-free parts of 150 and 250 rows: one segment fits into the first, two into the second.
    segments = cut_segments([counting_drive("a", 400, [150])], 1.0, 1.0)
    assert segments.row.tolist() == [0, 150, 250]


def test_recordings_too_short_are_refused_by_name():
    with pytest.raises(ValueError, match="recordings stub: no gap-free segment of 131 rows"):
        cut_segments([counting_drive("stub", 130)], 1.0, 1.0)


def test_smoothing_leaves_a_parabola_alone():
    drive = counting_drive("a", 300)
    time = torch.arange(300) * 0.01
    curve = torch.stack([1 + 2 * time - 3 * time**2, time**2, -time], -1)
    drive.data["velocity"], drive.data["pose"] = curve, 2 * curve
    segments = cut_segments([drive], 1.0, 1.0)
    torch.testing.assert_close(segments.smooth_velocity, segments.velocity, atol=1e-5, rtol=0)
    torch.testing.assert_close(segments.smooth_pose, segments.pose, atol=2e-5, rtol=0)


def test_a_smoothed_row_has_the_share_of_the_noise_that_least_squares_says():
    # Middle of a parabola through 2 m + 1 rows: variance (3 (3 m^2 + 3 m - 1)) /
    # ((2 m + 3) (2 m + 1) (2 m - 1)); with m = 7: 501 / (17 * 15 * 13) = 0.151.
    assert smoothing_rows(0.01) == 15
    drive = counting_drive("a", 40_000)
    drive.data["velocity"] = torch.randn(40_000, 3, generator=torch.Generator().manual_seed(0))
    segments = cut_segments([drive], 1.0, 1.31)
    assert float(segments.smooth_velocity.var()) == pytest.approx(501 / 3315, rel=0.05)


def test_segments_know_when_in_the_session_they_are():
    first, second = counting_drive("a", 131), counting_drive("b", 331)
    second.since_first = 60.0
    segments = cut_segments([first, second], 1.0, 1.0)
    torch.testing.assert_close(segments.elapsed, torch.tensor([0.0, 0.0, 1.0, 2.0]))
    torch.testing.assert_close(segments.session, torch.tensor([0.0, 60.0, 61.0, 62.0]))


def test_the_work_before_a_segment_is_the_mean_square_drive_of_each_interval():
    drive = counting_drive("a", 1400)
    drive.data["action"] = torch.zeros(1400, 2)  # half drive, for 12 s; 0.9 for the 2 s after
    drive.data["action"][1200:, 0] = 0.8
    segments = cut_segments([drive], 1.0, 1.0)
    at = {row: work for row, work in zip(segments.row.tolist(), segments.worked, strict=True)}
    assert at[0].abs().max() == 0
    # 7 s of 0.25: all of the first two intervals, 1 of 6 s of the third.
    expected = torch.tensor([0.25, 0.25, 0.25 / 6, 0, 0, 0, 0, 0])
    torch.testing.assert_close(at[700], expected)
    # Half a second of 0.81 and 2.5 s of 0.25 in the last three.
    assert len(at[1200]) == len(WORKED) - 1
    work = cut_segments([drive], 1.0, 0.5).worked[25]
    assert float(work[0]) == pytest.approx((0.5 * 0.81 + 2.5 * 0.25) / 3)


def test_windows_cover_segments_with_their_own_clocks_and_the_commands_before_them():
    # 1.0 s in windows of 0.4 s: three, that begin 0, 30 and 60 rows later.
    long = cut_segments([counting_drive("a", 400)], 1.0, 1.0)
    windows, part = long.windows(0.4)
    assert windows.horizon == 40
    assert part.tolist() == [0, 1, 2] * 3
    assert windows.row.tolist() == [0, 100, 200, 30, 130, 230, 60, 160, 260]
    assert windows.velocity[:, windows.start, 0].tolist() == [r + 30 for r in windows.row.tolist()]
    torch.testing.assert_close(windows.elapsed, windows.row * 0.01)
    torch.testing.assert_close(windows.session, windows.row * 0.01)
    cut = cut_segments([counting_drive("a", 400)], 0.4, 0.1)
    same = cut.row.tolist().index(130)
    assert torch.equal(windows.earlier[4], cut.earlier[same])
    assert torch.equal(windows.pose[4], cut.pose[same])


def test_a_window_as_long_as_its_segment_is_the_segment():
    long = cut_segments([counting_drive("a", 400)], 1.0, 1.0)
    windows, part = long.windows(5.0)
    assert part.tolist() == [0, 1, 2]
    assert torch.equal(windows.pose, long.pose)
