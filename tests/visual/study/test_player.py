"""The player's data."""

import numpy as np
import pytest

from buggy_rl.estimation.open_loop import load_rollouts, save_rollouts
from buggy_rl.visual.study.page import player
from tests.visual.study.made import straight


@pytest.fixture
def rollouts(tmp_path):
    wild = straight(speed=40.0)
    wild["pose"][1, 200:] = float("nan")
    made = {"near": straight(speed=0.8), "wild": wild}
    save_rollouts(tmp_path / "r.npz", list("abcdef"), 0.01, straight(), made)
    return load_rollouts(tmp_path / "r.npz")


def test_rollouts_come_back_at_25_rows_a_second(rollouts):
    assert list(rollouts.pose) == ["measured", "near", "wild"]
    assert rollouts.recording == list("abcdef")
    assert rollouts.pose["near"].shape == (6, 76, 3)
    np.testing.assert_allclose(rollouts.time[[0, 1, -1]], [0.0, 0.04, 3.0])
    np.testing.assert_allclose(rollouts.pose["near"][0, 25, 0], 0.8, atol=1e-6)


def test_a_segment_has_two_seconds_and_its_error_after_one(rollouts):
    shown = player(rollouts, ["near"])
    assert shown["time"][-1] == pytest.approx(2.0)
    assert len(shown["segments"]) == 6
    assert shown["segments"][3]["recording"] == "d"
    assert shown["segments"][0]["error"] == {"near": pytest.approx(0.2, abs=1e-4)}


def test_a_simulator_that_diverges_is_cut_off_where_it_leaves(rollouts):
    segments = player(rollouts, ["near", "wild"])["segments"]
    assert len(segments[0]["made"]["near"]) == 51
    assert len(segments[0]["made"]["wild"]) == 32  # 50 m at 40 m/s: 1.25 s
    assert len(segments[0]["measured"]) == 51


def test_an_error_that_is_not_finite_is_none(rollouts):
    rollouts.pose["wild"][1, 10:] = np.nan
    shown = player(rollouts, ["wild"])["segments"][1]
    assert shown["error"] == {"wild": None}
    assert len(shown["made"]["wild"]) == 10
