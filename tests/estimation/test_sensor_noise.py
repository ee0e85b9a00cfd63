import pytest
import torch

from buggy_rl.estimation.noise_model import noise_correlation, sensor_noise, start_noise
from buggy_rl.estimation.segments import cut_segments
from tests.drives import counting_drive, toy_drive


def test_the_noise_of_the_sensor_is_estimated_within_10_percent():
    deviation = torch.tensor([0.002, 0.003, 0.004, 0.02, 0.03, 0.05])
    drives = [toy_drive(str(seed), 1500, seed) for seed in range(2)]
    for seed, drive in enumerate(drives):
        noise = torch.randn(1500, 6, generator=torch.Generator().manual_seed(seed)) * deviation
        drive.data["pose"] += noise[:, :3]
        drive.data["velocity"] += noise[:, 3:]
    found = sensor_noise(cut_segments(drives, 1.0, 0.5))
    torch.testing.assert_close(found, deviation, rtol=0.1, atol=0)


def correlated(rho: float, seed: int, rows: int = 4000) -> torch.Tensor:
    """[rows, 6] of variance 1, AR(1) correlation rho."""
    fresh = torch.randn(rows, 6, generator=torch.Generator().manual_seed(seed))
    noise = [fresh[0]]
    for row in fresh[1:]:
        noise.append(rho * noise[-1] + (1 - rho**2) ** 0.5 * row)
    return torch.stack(noise)


@pytest.mark.parametrize(("rho", "off"), [(0.0, 0.1), (0.6, 0.15), (0.9, 0.3)])
def test_the_sd_of_correlated_noise_is_not_underestimated(rho, off):
    # White noise is estimated within a few percent; of rho 0.9 a parabola leaves 12 % only.
    deviation = torch.tensor([0.002, 0.003, 0.004, 0.02, 0.03, 0.05])
    drive = counting_drive("a", 4000)
    noise = correlated(rho, 3) * deviation
    drive.data["pose"], drive.data["velocity"] = noise[:, :3], noise[:, 3:]
    segments = cut_segments([drive], 1.0, 1.31)
    assert noise_correlation(segments) == pytest.approx(rho, abs=0.12)
    torch.testing.assert_close(sensor_noise(segments), deviation, rtol=off, atol=0)
    smooth = torch.cat([segments.smooth_pose, segments.smooth_velocity], -1).flatten(0, 1)
    torch.testing.assert_close(start_noise(segments), smooth.std(0), rtol=off, atol=0)


def test_fast_motion_in_some_channels_is_not_taken_for_correlated_noise():
    drive = counting_drive("a", 4000)
    noise = correlated(0.0, 3)
    noise[:, 4:] += 10 * correlated(0.95, 4)[:, 4:]
    drive.data["pose"], drive.data["velocity"] = noise[:, :3], noise[:, 3:]
    assert noise_correlation(cut_segments([drive], 1.0, 1.31)) == 0.0


def test_the_noise_of_a_sensor_is_at_least_its_rounding():
    found = sensor_noise(cut_segments([counting_drive("a", 400)], 1.0, 1.0))
    torch.testing.assert_close(found, torch.tensor([1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3]))
