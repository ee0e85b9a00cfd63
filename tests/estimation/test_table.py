from functools import partial

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.estimation.table import (
    ComparedSimulator,
    held_out_segments,
    markdown,
    rollout_errors,
    table_row,
)
from buggy_rl.recordings.resampling import past_mean
from buggy_rl.simulators import make_engine
from tests.drives import counting_drive, toy_drive


@pytest.fixture
def drives():
    return [toy_drive("a", 1200, 1, noise=0.05), toy_drive("b", 900, 2, noise=0.05)]


def test_test_segments_cover_both_recordings_evenly(drives):
    test = held_out_segments(drives, 50)
    assert len(test.segments) == 50
    per_drive = test.segments.recording.bincount()
    # a has 1200 - 331 starts, b 900 - 331: 869 to 569
    assert per_drive[0] / 50 == pytest.approx(869 / (869 + 569), abs=0.05)


def test_segments_that_overlap_may_share_a_number_and_recordings_never_do():
    test = held_out_segments([counting_drive("a", 700), counting_drive("b", 700)], 40)
    numbers, drive = test.segments.length_blocks(), test.segments.recording
    assert not set(numbers[drive == 0].tolist()) & set(numbers[drive == 1].tolist())
    assert ((test.segments.row // 331)[drive == 0] == numbers[drive == 0]).all()


def test_a_candidate_of_filtered_drives_starts_from_filtered_velocities(drives):
    test = held_out_segments(drives, 10)
    hold = partial(make_engine, "hold")
    made, _ = rollout_errors(ComparedSimulator("hold", hold, filter_width=5), test)
    row = int(test.segments.row[0]) + 30
    drive = drives[int(test.segments.recording[0])]
    smooth = past_mean(drive.data[keys.VELOCITY], 5)
    assert_close(made[keys.VELOCITY][0, 0], smooth[row])
    raw, _ = rollout_errors(ComparedSimulator("hold", hold), test)
    assert_close(raw[keys.VELOCITY][0, 0], drive.data[keys.VELOCITY][row])


def test_the_table_is_ordered_and_says_over_how_many_segments(drives):
    test = held_out_segments(drives, 20)
    rows = []
    for name in ("hold", "kinematic"):
        _, error = rollout_errors(ComparedSimulator(name, partial(make_engine, name)), test)
        rows.append(table_row(name, error, test.segments.length_blocks()))
    rows[0]["position_mse_1s"], rows[1]["position_mse_1s"] = 0.5, 0.25
    table = markdown(rows, 20, 2)
    assert table.startswith("Over 20 windows of 2 held-out drives")
    assert table.index("| kinematic") < table.index("| hold")
    assert torch.isfinite(
        torch.tensor([v for v in rows[0].values() if not isinstance(v, str)])
    ).all()
