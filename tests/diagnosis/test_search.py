from pathlib import Path

import pytest
import torch

from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.search import Search
from buggy_rl.estimation.cross_validation import evidences
from buggy_rl.estimation.misfit import Usual
from tests.diagnosis.planted import fitter

FEW = ["steering_dead_time", "steering_gain", "viscous_drag"]


def searched(recordings, effects, usual=None):
    return Search(fitter(recordings, effects), usual=usual).run()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nothing", ()),
        ("late", ("steering_dead_time",)),
        ("two", ("steering_gain", "viscous_drag")),
    ],
)
def test_it_finds_what_was_planted_and_nothing_else(drives, name, expected):
    found = searched(drives[name], FEW)
    assert tuple(sorted(found.best.causes)) == expected
    # Whoever goes on from there knows what it took: each explanation at least once.
    assert Search.after(fitter(drives[name], FEW), found).fitter.plays >= len(found.tried)


def test_where_a_simulator_is_as_right_as_ever_a_part_of_the_gap_is_no_news(drives):
    def named(effect, usual):
        return searched(drives["two"], [effect], usual).best.causes

    # Of two causes the drag makes half the gap, and the steering far less.
    as_ever = Usual(mean=100.0, error=0.0)
    assert named("steering_gain", None) == ("steering_gain",)
    assert named("steering_gain", as_ever) == ()
    assert named("viscous_drag", as_ever) == ("viscous_drag",)
    assert searched(drives["late"], FEW, as_ever).best.causes == ("steering_dead_time",)


def test_a_fit_that_is_stuck_goes_on_from_where_others_came_to(drives):
    search = Search(fitter(drives["late"], FEW))
    search.null = search.fit([search.fitter.start(())])[0]
    stuck, beyond = (
        search.fitter.start(causes, place)
        for causes, place in (
            (["steering_dead_time"], [0.1, 0.0]),
            (["steering_dead_time", "viscous_drag"], [1.2, 0.0, 0.0]),
        )
    )
    for fitted in (stuck, beyond):  # neither is fitted any further
        [fitted.white] = search.fitter.evaluate([(fitted, fitted.place)])
        search.fitter.differentiate([fitted])
        [known] = evidences(search.fitter, [fitted], search.group)
        search.tried[fitted.causes] = Candidate(fitted, known)
    base = search.tried["steering_dead_time",]
    better = search.taught(base)
    assert better is not None
    assert better.causes == base.causes
    assert search.loss(better) < search.loss(base)
    # Planted are 60 ms, which is the unit.
    assert float(better.fitted.place[0]) == pytest.approx(1.0, abs=0.05)
    assert search.taught(better) is None  # nobody knows better than that


def test_an_effect_that_is_not_in_the_library_is_not_mended_by_one_that_is(drives):
    found = searched(drives["draggy"], ["steering_dead_time", "gyro_bias"])
    assert found.best.causes == ()
    assert found.temper > 1.5  # and it knows that what it has is no good explanation


@pytest.mark.parametrize(("name", "expected"), [("nothing", ()), ("late", ("steering_dead_time",))])
def test_a_candidate_that_means_nothing_is_not_named(drives, name, expected):
    decoy = f"{Path(__file__).parent / 'decoy.py'}:Decoy"
    found = searched(drives[name], [*FEW, decoy])
    assert found.best.causes == expected
    # It was in the running: with three free numbers it follows a part of any gap.
    assert (decoy,) in found.tried


def test_the_same_drives_give_the_same_fit(late):
    fit, (right, wrong) = late
    again = fit.fit([fit.start(["steering_dead_time"]), fit.start(["steering_gain"])])
    for first, second in zip((right, wrong), again, strict=True):
        assert torch.equal(first.place, second.place)
        assert torch.equal(first.white, second.white)
