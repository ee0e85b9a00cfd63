"""How long after the first recording of a session each one begins."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.recordings import Recording
from buggy_rl.recordings.stamps import place_in_session


def recording(begin, seconds=10.0):
    time = begin + torch.arange(round(100 * seconds), dtype=torch.float64) / 100
    return Recording(f"at {begin}", TensorDict({keys.TIME: time[:, None]}, [len(time)]), 0.01)


def placed(*begins):
    recordings = [recording(begin) for begin in begins]
    place_in_session(recordings)
    return [each.since_first for each in recordings]


def test_absolute_stamps_tell_when_each_began_in_whatever_order_they_are_read():
    day = 1.7e9
    assert placed(day + 300.0, day, day + 100.0) == [300.0, 0.0, 100.0]


def test_files_that_each_begin_at_their_own_zero_tell_nothing():
    assert placed(0.0, 0.0, 0.0) == [0.0, 0.0, 0.0]
    assert placed(0.0, 5.0) == [0.0, 0.0]  # they overlap


def test_after_an_hour_a_new_session_begins():
    assert placed(0.0, 60.0, 5000.0, 5030.0) == [0.0, 60.0, 0.0, 30.0]


def test_one_recording_is_the_first():
    assert placed(77.0) == [0.0]
    place_in_session([])
