import pytest

from buggy_rl.recordings.windows import split
from tests.drives import counting_drive


def test_a_split_keeps_recordings_whole_and_does_not_depend_on_their_order():
    drives = [counting_drive(name, 5) for name in "abcdefgh"]
    training, held = split(drives, 0.25, seed=3)
    again = split(drives[::-1], 0.25, seed=3)[1]
    assert len(held) == 2
    assert {r.name for r in training} | {r.name for r in held} == set("abcdefgh")
    assert {r.name for r in held} == {r.name for r in again}


def test_holding_out_an_unknown_recording_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"\['z'\].*\['a', 'b'\]"):
        split([counting_drive("a", 5), counting_drive("b", 5)], ["z"])
