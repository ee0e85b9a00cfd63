"""The plan of the study: where policies are trained, and where they lie."""

import pytest

from buggy_rl.core.config import build
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.plan import TransferConfig


def test_the_shipped_study_has_twenty_cars_ten_seeds_and_nine_arms(repository):
    config = build(TransferConfig, [str(repository / "configs" / "transfer.yaml")])
    assert (len(config.names), len(config.seeds), len(config.arms)) == (20, 10, 9)
    assert config.drives * config.seconds == 120.0
    assert list(config.drawn("a secret")) == config.names


def test_every_policy_has_a_folder_of_its_own():
    config = TransferConfig("out", cars=2)
    folders = [config.folder(policy) for policy in config.policies()]
    assert len(set(folders)) == len(folders) == 2 * 9 * 10


def test_policies_are_trained_for_the_cars_that_are_asked_for():
    config = TransferConfig("out", cars=10, seeds=[0], arms=["as_given"], only=[10, 3])
    assert len(config.names) == 10
    assert config.trained_cars == ["03", "10"]
    assert [policy.car for policy in config.policies()] == ["03", "10"]
    assert TransferConfig("out", cars=2).trained_cars == ["01", "02"]


def test_an_arm_that_begins_with_another_one_has_a_tenth_of_its_steps():
    config = TransferConfig("out")
    assert {config.steps_of(arm) for arm in ARMS if ARMS[arm].start} == {24_000}
    assert {config.steps_of(arm) for arm in ARMS if not ARMS[arm].start} == {240_000}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"arms": ["mended"]}, "no arms .*mended.*as_given, repaired"),
        ({"stages": ["sell"]}, "no stages .*sell"),
        ({"drives": 1}, "drives is 1: must be 2"),
        ({"earlier": 2}, "earlier is 2: must be 3"),
        ({"control_every": 1}, "control_every is 1: must be 2"),
        ({"cars": 2, "only": [2, 3]}, r"only has \[3\]: cars have numbers from 1 to 2"),
        ({"arms": ["repaired", "continued"]}, "continued.* begin with policies of as_given"),
    ],
)
def test_what_cannot_be_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        TransferConfig("out", **wrong)
