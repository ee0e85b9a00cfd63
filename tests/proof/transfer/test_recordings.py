"""The drives that are all that is known of a concealed car."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.transfer.jobs import record, recorded
from buggy_rl.proof.transfer.plan import TransferConfig
from buggy_rl.recordings import load_recordings

CARS = {"weak": {"throttle_gain": {"gain": 0.5}}, "right": {}}


@pytest.fixture(scope="module")
def driven(tmp_path_factory) -> TransferConfig:
    config = TransferConfig(str(tmp_path_factory.mktemp("out")), cars=CARS, drives=3, seconds=1.5)
    assert not any(recorded(case, config.car(name)) for name, case in config.cases.items())
    record(list(config.cases.values()), [config.car(name) for name in config.cases])
    return config


def test_what_was_driven_is_there_and_is_not_driven_again(driven):
    assert all(recorded(case, driven.car(name)) for name, case in driven.cases.items())
    (driven.car("weak") / "baseline" / "before_2.csv").rename(driven.car("weak") / "moved.csv")
    assert not recorded(driven.cases["weak"], driven.car("weak"))
    (driven.car("weak") / "moved.csv").rename(driven.car("weak") / "baseline" / "before_2.csv")


def test_drives_of_the_car_and_from_before_have_names_of_their_own(driven):
    drives, refused = load_recordings([str(driven.car("weak"))])
    assert refused == []
    names = [drive.name for drive in drives]
    assert sorted(names) == [f"{kind}_{n}" for kind in ("before", "drive") for n in range(3)]
    assert all(len(drive.data) == 150 for drive in drives)


def test_what_is_concealed_is_in_the_drives_of_the_car_alone(driven, tmp_path):
    # The car of the same place, driver and camera in which nothing is concealed.
    right = replace(driven, output=str(tmp_path), cars={"weak": {}})
    record([right.cases["weak"]], [right.car("weak")])
    found = [
        {drive.name: drive.data[keys.POSE] for drive in load_recordings([str(c.car("weak"))])[0]}
        for c in (driven, right)
    ]
    alike = {name for name, pose in found[0].items() if torch.equal(pose, found[1][name])}
    assert alike >= {f"before_{n}" for n in range(3)}
    assert "drive_0" not in alike  # others may not have driven off yet
