import pytest
import torch
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.recordings.resampling import filtered, local_parabola, past_mean
from tests.drives import counting_drive


def test_past_mean_uses_the_past_alone():
    signal = torch.tensor([[0.0], [3.0], [6.0], [9.0]])
    # width 3: 0/1, (0+3)/2, (0+3+6)/3, (3+6+9)/3
    assert past_mean(signal, 3).flatten().tolist() == [0.0, 1.5, 3.0, 6.0]
    changed = signal.clone()
    changed[3] = 100.0
    assert_close(past_mean(changed, 3)[:3], past_mean(signal, 3)[:3])


def test_a_local_parabola_preserves_slope_and_curvature():
    t = torch.arange(20.0)[:, None]
    parabola = 1 + 2 * t - 0.3 * t.square()
    assert_close(local_parabola(parabola, 7), parabola, atol=1e-4, rtol=0)
    assert_close(local_parabola(parabola[:5], 7), parabola[:5])
    with pytest.raises(ValueError, match="odd"):
        local_parabola(parabola, 4)


def test_filtering_does_not_reach_across_a_gap():
    drive = filtered(counting_drive("a", 10, segments=[5]), 5)
    assert drive.data[keys.VELOCITY][5, 0] == 5.0


def test_filtering_leaves_the_original_recording_alone():
    drive = counting_drive("a", 10)
    filtered(drive, 5)
    assert drive.data[keys.VELOCITY][:, 0].tolist() == list(range(10))
