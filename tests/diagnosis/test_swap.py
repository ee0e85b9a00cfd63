from dataclasses import replace

import pytest

from buggy_rl.diagnosis import swap
from buggy_rl.diagnosis.search import Search
from buggy_rl.diagnosis.swap import exchanges
from buggy_rl.estimation.misfit import Usual
from tests.diagnosis.planted import fitter

FEW = ["steering_dead_time", "steering_gain", "viscous_drag"]
ALONE = [(), ("steering_dead_time",), ("steering_gain",)]


def knowing(drives):
    """A search that knows two rivals alone, and the wrong one beside a drag that is there."""
    search = Search(fitter(drives["two"], FEW))
    search.null = search.fit([search.fitter.start(())])[0]
    search.fit([search.fitter.start(c) for c in (*ALONE, ("steering_dead_time", "viscous_drag"))])
    return search


@pytest.fixture(scope="module")
def search(drives):
    return knowing(drives)


def begun(search):
    best = search.tried["steering_dead_time", "viscous_drag"]
    return exchanges(search.fitter, best, search.tried, search.null)


def test_a_rival_that_was_near_alone_is_tried_beside_the_rest_from_where_both_were(search):
    [start] = begun(search)
    assert start.causes == ("steering_gain", "viscous_drag")
    gain = search.tried["steering_gain",].fitted.values()["steering_gain"]
    drag = search.tried["steering_dead_time", "viscous_drag"].fitted.values()["viscous_drag"]
    assert start.values()["steering_gain"] == gain
    assert start.values()["viscous_drag"] == drag


def test_a_rival_that_leaves_far_more_is_not(search, monkeypatch):
    # Alone the gain leaves less than the dead time does: nothing is nearer than that.
    monkeypatch.setattr(swap, "NEAR", -1.0)
    assert begun(search) == []


def test_a_single_cause_has_no_place_to_change(search):
    single = search.tried["steering_gain",]
    assert exchanges(search.fitter, single, search.tried, search.null) == []


def test_the_better_one_takes_the_place_and_is_not_tried_again(search):
    wrong = search.tried["steering_dead_time", "viscous_drag"]
    better = search.exchanged(wrong)
    assert better.causes == ("steering_gain", "viscous_drag")
    assert search.exchanged(better) is better
    assert begun(search) == []
    # Nor need it be: what was tried on the way is better as well.
    assert search.exchanged(wrong) is better


def test_one_that_does_not_earn_its_place_does_not_take_it(drives):
    search = knowing(drives)
    wrong = search.tried["steering_dead_time", "viscous_drag"]
    search.merit = replace(search.merit, usual=Usual(mean=0.0, error=1e9))
    assert search.exchanged(wrong) is wrong
    # It was tried all the same: whoever weighs rivals knows how near it came.
    assert ("steering_gain", "viscous_drag") in search.tried
