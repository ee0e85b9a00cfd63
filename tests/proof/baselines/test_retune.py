"""Re-tuning alone."""

import pytest

from buggy_rl.estimation.hypothesis import Library
from buggy_rl.proof.baselines.retune import retune
from tests.proof.baselines.folder import shown

FEW = ("drive_force", "left_angle", "viscous_friction", "rear_grip")


@pytest.fixture(autouse=True)
def _few(monkeypatch):
    """Parameters that short drives can tell apart."""

    def library(effects, declared):
        return Library(effects, {name: declared[name] for name in FEW})

    monkeypatch.setattr("buggy_rl.proof.baselines.retune.Library", library)


def test_the_parameter_that_is_off_is_named_as_the_effect_it_is(drives, tmp_path):
    said = retune(shown(tmp_path, drives["weak"]))
    assert said["verdict"] == "wrong_parameters"
    assert said["effects"][0]["name"] == "throttle_gain"
    assert said["notes"][-1].startswith("drive_force is 7")


def test_nothing_is_named_where_nothing_is_off(drives, tmp_path):
    assert retune(shown(tmp_path, drives["nothing"]))["effects"] == []


def test_what_was_off_before_is_not_blamed(drives, tmp_path):
    said = retune(shown(tmp_path, drives["weak"], baseline=drives["weak"][:1]))
    assert said["effects"] == []


def test_a_simulator_that_declares_nothing_says_whether_it_is_right(drives, tmp_path):
    said = retune(shown(tmp_path, drives["nothing"], engine="hold"))
    assert (said["verdict"], said["effects"]) == ("cannot_tell", [])
    assert said["notes"][0].startswith("there are no parameters to tune")


def test_as_wrong_as_before_is_no_mismatch(drives, tmp_path):
    seen = shown(tmp_path, drives["nothing"], engine="hold", baseline=drives["before"])
    assert retune(seen)["verdict"] == "no_mismatch"
