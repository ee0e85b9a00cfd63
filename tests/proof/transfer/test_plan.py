"""The plan of the study: which cars, which policies, where they lie."""

import pytest

from buggy_rl.core.config import build
from buggy_rl.proof.plants import abilities
from buggy_rl.proof.transfer.plan import Trained, TransferConfig

LATE = {"steering_dead_time": {"dead_time": 0.08}}
HEAVY = {"payload": {"mass_ratio": 1.4}}


def test_the_shipped_study_has_seven_cars_with_a_fault_and_one_without(repository):
    config = build(TransferConfig, [str(repository / "configs" / "transfer.yaml")])
    assert [bool(concealed) for concealed in config.cars.values()] == [True] * 7 + [False]
    assert [len(case.concealed) for case in config.cases.values()].count(2) == 1
    # 2 arms that know the car x 8 cars x 3 seeds, and 2 that do not x 3 seeds.
    assert len(config.policies()) == 2 * 8 * 3 + 2 * 3
    assert all(set(c.concealed) <= abilities("reference") for c in config.cases.values())


def test_what_is_given_of_a_car_is_two_minutes(repository):
    config = build(TransferConfig, [str(repository / "configs" / "transfer.yaml")])
    assert config.drives * config.seconds == 120.0


def test_every_policy_has_a_folder_of_its_own():
    config = TransferConfig("out", cars={"late": LATE, "heavy": HEAVY})
    folders = [config.folder(policy) for policy in config.policies()]
    assert len(set(folders)) == len(folders)


def test_an_arm_that_knows_no_car_is_trained_once_for_all():
    one = TransferConfig("out", cars={"late": LATE}, arms=["unrepaired"])
    two = TransferConfig("out", cars={"late": LATE, "heavy": HEAVY}, arms=["unrepaired"])
    assert one.policies() == two.policies() == [Trained("unrepaired", "", n) for n in range(3)]


def test_a_car_stays_the_same_when_another_is_added():
    one = TransferConfig("out", cars={"late": LATE})
    two = TransferConfig("out", cars={"late": LATE, "heavy": HEAVY})
    assert two.cases["late"] == one.cases["late"]
    assert two.cases["heavy"].seed != two.cases["late"].seed


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"arms": ["mended"]}, "no arms .*mended.*unrepaired, repaired"),
        ({"stages": ["sell"]}, "no stages .*sell"),
        ({"drives": 2}, "drives is 2: must be 3"),
        ({"cars": {"my car": LATE}}, "folders, too: .*my car"),
    ],
)
def test_what_cannot_be_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        TransferConfig("out", **wrong)
