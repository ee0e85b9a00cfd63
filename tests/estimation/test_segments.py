import pytest
import torch

from buggy_rl.estimation.segments import (
    SMOOTHING,
    WARM_UP,
    colour,
    sensor_noise,
    start_noise,
    stretches,
)
from tests.drives import counting_drive, toy_drive


def test_a_drive_is_cut_into_stretches_of_its_own_rows():
    # 1.0 s is 30 + 100 + 1 = 131 rows; of 400 rows 131 fit at 0, 100 and 200 (till 330), not 300.
    cut = stretches([counting_drive("a", 130), counting_drive("b", 400)], 1.0, 1.0)
    assert len(cut) == 3
    assert cut.horizon == 100
    assert cut.row.tolist() == [0, 100, 200]
    assert cut.drive.tolist() == [1, 1, 1]  # the first is a row too short
    assert cut.velocity[:, WARM_UP, 0].tolist() == [30, 130, 230]
    assert cut.action[1, :, 1].tolist() == [-row for row in range(100, 231)]
    torch.testing.assert_close(cut.elapsed, torch.tensor([0.0, 1.0, 2.0]))
    part = cut[torch.tensor([2])]
    assert len(part) == 1
    assert part.row.tolist() == [200]
    assert part.dt == cut.dt


def test_no_stretch_crosses_a_gap():
    # Segments of 150 and 250 rows: one stretch fits into the first and two into the second.
    cut = stretches([counting_drive("a", 400, [150])], 1.0, 1.0)
    assert cut.row.tolist() == [0, 150, 250]


def test_drives_too_short_are_refused_by_name():
    with pytest.raises(ValueError, match="no gap-free stretch of 131 rows in stub"):
        stretches([counting_drive("stub", 130)], 1.0, 1.0)


def test_smoothing_leaves_a_parabola_alone():
    drive = counting_drive("a", 300)
    time = torch.arange(300) * 0.01
    curve = torch.stack([1 + 2 * time - 3 * time**2, time**2, -time], -1)
    drive.data["velocity"], drive.data["pose"] = curve, 2 * curve
    cut = stretches([drive], 1.0, 1.0)
    torch.testing.assert_close(cut.smooth_velocity, cut.velocity, atol=1e-5, rtol=0)
    torch.testing.assert_close(cut.smooth_pose, cut.pose, atol=2e-5, rtol=0)


def test_a_smoothed_row_has_the_share_of_the_noise_that_least_squares_says():
    # Middle of a parabola through 2 m + 1 rows: variance (3 (3 m^2 + 3 m - 1)) /
    # ((2 m + 3) (2 m + 1) (2 m - 1)); with m = 7: 501 / (17 * 15 * 13) = 0.151.
    assert SMOOTHING == 15
    drive = counting_drive("a", 40_000)
    drive.data["velocity"] = torch.randn(40_000, 3, generator=torch.Generator().manual_seed(0))
    cut = stretches([drive], 1.0, 1.31)
    assert float(cut.smooth_velocity.var()) == pytest.approx(501 / 3315, rel=0.05)


def test_the_noise_of_the_sensor_is_estimated_within_10_percent():
    deviation = torch.tensor([0.002, 0.003, 0.004, 0.02, 0.03, 0.05])
    drives = [toy_drive(str(seed), 1500, seed) for seed in range(2)]
    for seed, drive in enumerate(drives):
        noise = torch.randn(1500, 6, generator=torch.Generator().manual_seed(seed)) * deviation
        drive.data["pose"] += noise[:, :3]
        drive.data["velocity"] += noise[:, 3:]
    found = sensor_noise(stretches(drives, 1.0, 0.5))
    torch.testing.assert_close(found, deviation, rtol=0.1, atol=0)


def coloured(rho: float, seed: int, rows: int = 4000) -> torch.Tensor:
    """[rows, 6] of variance 1, correlated by rho from row to row."""
    fresh = torch.randn(rows, 6, generator=torch.Generator().manual_seed(seed))
    noise = [fresh[0]]
    for row in fresh[1:]:
        noise.append(rho * noise[-1] + (1 - rho**2) ** 0.5 * row)
    return torch.stack(noise)


@pytest.mark.parametrize(("rho", "off"), [(0.0, 0.1), (0.6, 0.15), (0.9, 0.3)])
def test_noise_whose_rows_go_together_is_not_taken_for_less(rho, off):
    # White noise would be told within a few percent; of rho 0.9 a parabola leaves 12 % only.
    deviation = torch.tensor([0.002, 0.003, 0.004, 0.02, 0.03, 0.05])
    drive = counting_drive("a", 4000)
    noise = coloured(rho, 3) * deviation
    drive.data["pose"], drive.data["velocity"] = noise[:, :3], noise[:, 3:]
    cut = stretches([drive], 1.0, 1.31)
    assert colour(cut) == pytest.approx(rho, abs=0.12)
    torch.testing.assert_close(sensor_noise(cut), deviation, rtol=off, atol=0)
    smooth = torch.cat([cut.smooth_pose, cut.smooth_velocity], -1).flatten(0, 1)
    torch.testing.assert_close(start_noise(cut), smooth.std(0), rtol=off, atol=0)


def test_a_car_that_moves_fast_in_some_channels_is_no_coloured_noise():
    drive = counting_drive("a", 4000)
    noise = coloured(0.0, 3)
    noise[:, 4:] += 10 * coloured(0.95, 4)[:, 4:]
    drive.data["pose"], drive.data["velocity"] = noise[:, :3], noise[:, 3:]
    assert colour(stretches([drive], 1.0, 1.31)) == 0.0


def test_a_sensor_without_noise_is_taken_to_round():
    found = sensor_noise(stretches([counting_drive("a", 400)], 1.0, 1.0))
    torch.testing.assert_close(found, torch.tensor([1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3]))
