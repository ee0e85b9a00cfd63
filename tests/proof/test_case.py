"""Cases: what they are called, and that nothing is lost on the disk."""

import json
from dataclasses import asdict

import pytest

from buggy_rl.proof.cases.case import Case

TWO = {"payload": {"mass_ratio": 1.3}, "gyro_bias": {"bias": -0.1}}


def test_a_case_comes_back_from_json_as_it_was():
    case = Case(7, "mujoco", "single_track_fitted", True, TWO, "jitter", "steady", 20.0, 3, 2)
    assert Case(**json.loads(json.dumps(asdict(case)))) == case


def test_a_family_is_what_is_concealed():
    families = {
        "nothing": {},
        "one": {"wind": {"force_x": 0.2, "force_y": 0.2}},
        "two": TWO,
        "unknown": {"sticky_servo": {"breakaway": 0.2}},
    }
    for family, concealed in families.items():
        assert Case(1, "reference", "reference", concealed=concealed).family == family


def test_what_is_wrong_with_the_camera_is_not_in_the_car():
    case = Case(1, "reference", "reference", concealed=TWO)
    assert case.faults == {"payload": {"mass_ratio": 1.3}}
    assert case.camera == {"gyro_bias": -0.1}
    assert case.truth == ("gyro_bias", "payload")


@pytest.mark.parametrize(
    "wrong", [{"nuisance": "pink"}, {"driving": "drunk"}, {"concealed": {"gremlin": {}}}]
)
def test_a_name_that_nobody_knows_is_refused_with_those_there_are(wrong):
    with pytest.raises(ValueError, match=r"no .*available: "):
        Case(1, "reference", "reference", **wrong)
