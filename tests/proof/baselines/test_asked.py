"""What a method sees of a case."""

import pytest

from buggy_rl.proof.baselines.asked import open_question
from tests.proof.baselines.folder import shown


def test_all_that_the_question_names_is_opened(drives, tmp_path):
    seen = shown(tmp_path, drives["offset"], baseline=drives["before"], effects=["gyro_bias"])
    question = open_question(seen)
    assert [len(drive) for drive in question.recordings] == [1300, 1300]
    assert [drive.name for drive in question.baseline] == ["drive_0", "drive_1"]
    assert question.config.effects == ["gyro_bias"]
    assert question.maker({"mass": 2.0})(3).declared["mass"].value == 2.0
    assert open_question(seen) is question


def test_a_car_may_have_a_name_instead_of_a_file(drives, tmp_path):
    seen = shown(tmp_path, drives["nothing"])
    with open(seen / "question.yaml", "a") as question:
        question.write("\ncar: buggy\n")
    assert open_question(seen).config.car == "buggy"


def test_segments_are_thinned_evenly(drives, tmp_path):
    question = open_question(shown(tmp_path, drives["nothing"]))
    few = question.segments(question.recordings, 5)
    assert len(few) == 5
    assert few.recording.tolist() in ([0, 0, 0, 1, 1], [0, 0, 1, 1, 1])
    assert few.spread(5) is few


def test_a_folder_without_recordings_is_refused(tmp_path):
    seen = shown(tmp_path, [])
    (seen / "recordings").mkdir()
    with pytest.raises(ValueError, match="recordings"):
        open_question(seen)
