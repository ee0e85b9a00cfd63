"""The drives that are all that is known of a car."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.transfer.jobs import record, recorded
from buggy_rl.proof.transfer.plan import TransferConfig
from buggy_rl.recordings import load_recordings

WEAK = {"throttle_gain": {"gain": 0.5}}


def cases(config, *concealed):
    drawn = config.drawn("a secret")
    return {
        name: replace(case, concealed=hidden)
        for (name, case), hidden in zip(drawn.items(), concealed, strict=True)
    }


@pytest.fixture(scope="module")
def driven(tmp_path_factory) -> TransferConfig:
    output = str(tmp_path_factory.mktemp("out"))
    config = TransferConfig(output, cars=2, drives=2, earlier=3, seconds=1.5)
    assert not any(recorded(config, car) for car in config.names)
    record(config, cases(config, WEAK, {}))
    return config


def poses(config, car):
    drives, refused = load_recordings([str(config.car(car))])
    assert refused == []
    return {drive.name: drive.data[keys.POSE] for drive in drives}


def test_what_was_driven_is_there(driven):
    assert all(recorded(driven, car) for car in driven.names)
    (driven.car("01") / "earlier" / "earlier_2.csv").rename(driven.car("01") / "moved")
    assert not recorded(driven, "01")
    (driven.car("01") / "moved").rename(driven.car("01") / "earlier" / "earlier_2.csv")


def test_drives_before_and_after_the_change_have_names_of_their_own(driven):
    names = {"drive_0", "drive_1", "before_0", "before_1", "earlier_0", "earlier_1", "earlier_2"}
    assert set(poses(driven, "01")) == names
    assert all(len(pose) == 150 for pose in poses(driven, "01").values())


def test_what_is_concealed_is_in_the_drives_after_the_change_alone(driven, tmp_path):
    right = replace(driven, output=str(tmp_path))
    record(right, cases(right, {}, {}))
    found = [poses(config, "01") for config in (driven, right)]
    alike = {name for name, pose in found[0].items() if torch.equal(pose, found[1][name])}
    assert alike >= {"before_0", "before_1", "earlier_0", "earlier_1", "earlier_2"}
    assert "drive_0" not in alike  # the other may not have driven off yet
