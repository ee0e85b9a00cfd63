"""Cases at other rates: commands held, frames as far apart, the same car in between."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, draw
from buggy_rl.proof.cases.drives import drive_cases
from buggy_rl.proof.cases.simulators import diagnosis_options, recorded_case_drive
from buggy_rl.proof.plants import abilities

CASE = Case(7, "reference", "reference", seconds=2.0, drives=1, held_out=0)


@pytest.fixture(scope="module")
def true():
    return {rate: drive_cases([replace(CASE, rate=rate)])[0].changed[0] for rate in (20, 100)}


@pytest.mark.slow
def test_a_command_is_held_until_the_next_one(true):
    action = true[20][keys.ACTION].view(-1, 5, 2)
    assert torch.equal(action, action[:, :1].expand_as(action))
    assert bool((action[1:, 0] != action[:-1, 0]).any())
    assert not torch.equal(true[100][keys.ACTION][1::5], true[100][keys.ACTION][::5])


@pytest.mark.parametrize("nuisance", ["white", "coloured", "dropped", "jitter"])
def test_frames_are_as_far_apart_as_the_rate_says(true, nuisance):
    recording = recorded_case_drive(replace(CASE, rate=20, nuisance=nuisance), true[20], False, 0)
    assert recording.dt == 0.05
    time = recording.data[keys.TIME][:, 0]
    steps = time.diff() / 0.05
    assert float((steps - steps.round()).abs().max()) < 0.2
    at = (time / 0.01).round().long()
    assert torch.allclose(recording.data[keys.ACTION], true[20][keys.ACTION][at], atol=1e-5)
    assert torch.equal(recording.data[keys.SEGMENT].diff() > 0, steps.round() > 1)


@pytest.mark.parametrize("early", [1, -1])
def test_a_stamp_is_off_by_a_frame_of_its_rate(true, early):
    stamps = [recorded_case_drive(replace(CASE, seed=s, rate=20), true[20], False, 0) for s in (1,)]
    right = stamps[0].data[keys.ACTION]
    moved_on = {
        int(side)
        for seed in range(1, 12)
        for shown in [
            recorded_case_drive(
                replace(CASE, seed=seed, rate=20, nuisance="stamps"), true[20], False, 0
            )
        ]
        for side in (1, -1)
        if torch.equal(shown.data[keys.ACTION][2:-2], right.roll(-side, 0)[2:-2])
    }
    assert early in moved_on


def test_the_diagnosis_is_told_and_a_learned_model_refused():
    assert "rate: 20" in diagnosis_options(replace(CASE, rate=20), [])
    assert "rate" not in diagnosis_options(CASE, [])
    with pytest.raises(ValueError, match="learned models are prepared at 100 Hz"):
        replace(CASE, rate=50, simulator="learned")
    with pytest.raises(ValueError, match="must be one of 20, 25, 50, 100"):
        replace(CASE, rate=30)


def test_rates_are_drawn_and_leave_the_rest_as_it_was():
    can = {"reference": abilities("reference")}
    usual = DrawConfig(pairings=["reference", "reference_learned_alone"])
    rated = replace(usual, rates=[20, 50])
    for seed in range(40):
        before, after = draw(seed, usual, can), draw(seed, rated, can)
        assert replace(after, rate=100) == before
        assert (after.rate == 100) == (after.simulator == "learned")
