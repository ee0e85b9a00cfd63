"""A patch that holds all that was driven is the floor; a short dead time is of a lag beside it."""

from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.search.limits import (
    PROMISING,
    covers_what_was_driven,
    missing_hypotheses,
    same_sets,
    words_of,
)
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.effects import EFFECTS
from buggy_rl.estimation.hypothesis import Library

LIBRARY = Library(["grip_patch", "tire_grip", "wind"])
PATCH, FLOOR, BOTH = ("grip_patch",), ("tire_grip",), ("grip_patch", "wind")
# Along x from -2 to 2 m.
DRIVEN = SimpleNamespace(pose=torch.linspace(-2.0, 2.0, 401).view(1, -1, 1) * torch.eye(3)[0])


def candidate(effects, radius=10.0, sd=0.0, x=0.0):
    own = {"x": x, "y": 0.0, "radius": radius, "grip": 0.4}
    known = {
        ("grip_patch", p.name): float(p.coordinate(own[p.name]))
        for p in LIBRARY.numbers("grip_patch")
    }
    fit = LIBRARY.at(effects, known)
    variance = torch.full_like(fit.vector, sd**2)
    return SimpleNamespace(fit=fit, cross_validated=SimpleNamespace(covariance=variance.diag()))


@pytest.mark.parametrize(
    ("radius", "sd", "expected"),
    [
        (2.0, 0.0, True),  # all rows
        (1.92, 0.0, True),  # 96 % of them
        (1.8, 0.0, False),  # 90 %
        (1.0, 0.0, False),
        (1.0, 0.3, True),  # +- 1.2 m of place and 0.3 m of radius: none is surely outside
    ],
)
def test_a_patch_is_the_floor_where_it_covers_what_was_driven(radius, sd, expected):
    assert covers_what_was_driven(candidate(PATCH, radius, sd), DRIVEN) is expected


def test_sets_with_such_a_patch_are_those_with_the_floor():
    tried = {PATCH: candidate(PATCH), BOTH: candidate(BOTH), FLOOR: None, ("wind",): None}
    assert same_sets(tried, DRIVEN) == {PATCH: FLOOR}  # the library may lack the floor's effect
    tried["tire_grip", "wind"] = None
    assert same_sets(tried, DRIVEN) == {PATCH: FLOOR, BOTH: ("tire_grip", "wind")}
    small = {PATCH: candidate(PATCH, 0.5)}
    assert same_sets(small, DRIVEN) == {}


def test_their_probabilities_add_before_anything_is_named():
    # As on tape: the patch is ahead of the floor, and alone neither has half.
    given = Posterior({(): 0.01, PATCH: 0.45, FLOOR: 0.36, ("wind",): 0.03}, 0.15)
    assert given.best == PATCH
    merged = given.merged({PATCH: FLOOR})
    assert merged.best == FLOOR
    assert merged.of("tire_grip") == pytest.approx(0.81)
    assert merged.of("grip_patch") == 0.0
    assert merged.nothing + merged.unknown + sum(
        p for e, p in merged.sets.items() if e
    ) == pytest.approx(1.0)


def test_a_floor_that_was_not_fitted_is_fitted_from_the_patchs_grip():
    [start] = missing_hypotheses({BOTH: candidate(BOTH)}, DRIVEN, LIBRARY)
    assert start.effects == ("tire_grip", "wind")
    assert start.values()["tire_grip"]["grip"] == pytest.approx(0.4)
    fitted = {BOTH: candidate(BOTH), ("tire_grip", "wind"): None}
    assert missing_hypotheses(fitted, DRIVEN, LIBRARY) == []
    assert missing_hypotheses({PATCH: candidate(PATCH)}, DRIVEN, Library(["grip_patch"])) == []


def test_of_many_such_sets_the_most_promising_are_fitted():
    others = [tuple(sorted(["grip_patch", name])) for name in EFFECTS if name not in BOTH][:9]
    starts = missing_hypotheses({key: candidate(key) for key in others}, DRIVEN, Library())
    assert len(starts) == PROMISING
    assert [{*start.effects} - {"tire_grip"} for start in starts] == [
        {*key} - {"grip_patch"} for key in others[:PROMISING]
    ]


def test_it_is_said_wherever_it_was_driven():
    assert words_of("tire_grip", {PATCH: FLOOR}) == ", wherever it was driven"
    assert words_of("tire_grip", {}) == ""
    assert words_of("wind", {PATCH: FLOOR}) == ""


LINE = Library(["throttle_dead_time", "throttle_lag", "steering_lag"])
TWO = ("throttle_dead_time", "throttle_lag")


def line(effects, dead_time):
    own = {"throttle_dead_time": ("dead_time", dead_time), "throttle_lag": ("time_constant", 0.1)}
    known = {
        (name, p.name): float(p.coordinate(own[name][1]))
        for name in own
        for p in LINE.numbers(name)
        if p.name == own[name][0]
    }
    return SimpleNamespace(fit=LINE.at(effects, known))


@pytest.mark.parametrize(("dead_time", "expected"), [(0.015, True), (0.04, False)])
def test_a_short_dead_time_beside_a_lag_is_the_lags(dead_time, expected):
    # 15 ms are what the second of two lags in a row leaves, 85 and 15 ms; 40 ms are a radio's.
    tried = {TWO: line(TWO, dead_time), ("throttle_lag",): None}
    assert same_sets(tried, DRIVEN) == ({TWO: ("throttle_lag",)} if expected else {})


def test_a_dead_time_without_a_lag_of_its_own_channel_stays_one():
    beside = ("steering_lag", "throttle_dead_time")
    tried = {e: line(e, 0.015) for e in (beside, ("throttle_dead_time",))}
    assert same_sets(tried, DRIVEN) == {}


def test_the_lag_alone_is_fitted_from_its_own_number():
    [start] = missing_hypotheses({TWO: line(TWO, 0.015)}, DRIVEN, LINE)
    assert start.effects == ("throttle_lag",)
    assert start.values()["throttle_lag"]["time_constant"] == pytest.approx(0.1)
    assert words_of("throttle_lag", {TWO: ("throttle_lag",)}) == ""
