"""Cases follow from seed and secret; an edit that cannot be made is drawn again."""

from collections import Counter
from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.real.dataset import Dataset, DatasetConfig
from buggy_rl.proof.real.draw import RealDrawConfig, drawn, edited_half
from buggy_rl.proof.real.edits import EDITS
from tests.proof.real.plant import SPEED

MANY = RealDrawConfig(cases=60, least=15.0)


def copy_of(dataset, name="copy"):
    """A dataset whose recordings can be changed."""
    own = [replace(r, data=r.data.clone()) for r in dataset.recordings]
    return Dataset(name, dataset.config, own)


@pytest.fixture(scope="module")
def cases(dataset):
    return drawn(MANY, {"small": dataset}, "secret")


def test_the_same_seed_and_secret_draw_the_same_and_no_other_secret_does(dataset, cases):
    assert drawn(MANY, {"small": dataset}, "secret") == cases
    others = drawn(MANY, {"small": dataset}, "another")
    assert (
        sum(one.concealed == other.concealed for one, other in zip(cases, others, strict=True)) < 20
    )
    assert len({case.id for case in cases}) == 60


def test_development_cases_are_of_other_divisions_than_sealed_ones(dataset):
    def numbers(**other):
        config = RealDrawConfig(cases=12, partitions=1, least=1.0, **other)
        return {case.half[:-1] for case in drawn(config, {"own": dataset}, "s")}

    assert numbers() == {"0"}
    assert numbers(first_partition=1) == {"1"}


def test_a_case_is_the_same_whatever_is_drawn_beside_it(dataset, cases):
    few = replace(MANY, first=7, cases=2)
    assert drawn(few, {"small": dataset}, "secret") == cases[7:9]


def test_families_engines_and_baselines_come_as_often_as_they_are_listed(dataset):
    many = drawn(replace(MANY, cases=300), {"small": dataset}, "secret")
    families = Counter(case.family for case in many)
    # 15, 50, 20 and 15 % of 300: within three standard deviations, 26 at most.
    for family, share in {"nothing": 45, "one": 150, "two": 60, "unknown": 45}.items():
        assert abs(families[family] - share) < 26
    assert abs(Counter(case.baseline for case in many)[True] - 200) < 26
    assert {case.engine for case in many} == {"single_track", "mujoco", "learned"}
    assert {case.half for case in many} == {"0a", "0b", "1a", "1b"}
    assert {name for case in many for name in case.concealed} == {*EDITS}


def test_two_edits_are_of_different_mechanisms(cases):
    pairs = [case for case in cases if case.family == "two"]
    assert pairs
    for case in pairs:
        assert len({EDITS[name].mechanism for name in case.truth}) == 2


def test_what_is_drawn_can_be_made_and_is_long_enough(dataset, cases):
    for case in cases:
        left = edited_half(dataset, case.half, case.concealed)
        assert sum(r.duration for r in left) >= 15.0
        assert all(float(r.data[keys.ACTION].abs().max()) <= 1.0 for r in left)


def test_a_recording_in_which_a_command_would_leave_its_range_is_left_out(dataset):
    own = copy_of(dataset)
    half = own.half("0a")
    half[0].data[keys.ACTION][500, 1] = 0.99
    left = edited_half(own, "0a", {"steering_offset": {"offset": -0.1}})
    assert [r.name for r in left] == [half[1].name]


def test_where_no_edit_can_be_made_that_is_said(dataset):
    still = copy_of(dataset, "still")
    for drive in still.recordings:
        drive.data[keys.ACTION][:, 1] = 0.0
    only = replace(MANY, families=["one"], edits=["steering_gain"], cases=1)
    with pytest.raises(ValueError, match="no edit of the family 'one' leaves 15 s of a half"):
        drawn(only, {"still": still})


def test_a_speed_command_gets_no_edit_of_a_battery(dataset):
    fast = [replace(r, command=SPEED) for r in dataset.recordings]
    many = drawn(replace(MANY, families=["one"]), {"fast": Dataset("fast", dataset.config, fast)})
    assert "battery_sag" not in {name for case in many for name in case.concealed}
    only = replace(MANY, families=["one"], edits=["battery_sag"])
    with pytest.raises(ValueError, match="none of them is of the family"):
        drawn(only, {"fast": Dataset("fast", dataset.config, fast)})


def test_datasets_are_drawn_by_their_weight(dataset):
    heavy = Dataset("heavy", DatasetConfig([], car="buggy", weight=3), dataset.recordings)
    many = drawn(replace(MANY, cases=200, families=["nothing"]), {"small": dataset, "heavy": heavy})
    assert abs(Counter(case.dataset for case in many)["heavy"] - 150) < 19


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"families": ["three"]}, "draw.families: no"),
        ({"engines": ["hold"]}, "draw.engines: no"),
        ({"edits": ["wind"]}, "draw.edits: no"),
        ({"partitions": 0}, "must be 1 at least"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        RealDrawConfig(**wrong)


def test_no_column_is_touched_but_those_of_the_edit(dataset):
    [one, *_] = edited_half(dataset, "0a", {"throttle_gain": {"gain": 1.2}})
    untouched = dataset.half("0a")[0]
    for key in (keys.TIME, keys.POSE, keys.VELOCITY):
        assert torch.equal(one.data[key], untouched.data[key])
    assert torch.equal(one.data[keys.ACTION][:, 1], untouched.data[keys.ACTION][:, 1])
    assert not torch.equal(one.data[keys.ACTION][:, 0], untouched.data[keys.ACTION][:, 0])
