from dataclasses import replace

import pytest

from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.search import State, swapped, tried_too
from buggy_rl.diagnosis.selection import Criteria
from buggy_rl.diagnosis.swap import swap_starts
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.misfit import BaselineMisfit
from tests.diagnosis.planted import problem_of

FEW = ["steering_dead_time", "steering_gain", "viscous_drag"]
WRONG, RIGHT = ("steering_dead_time", "viscous_drag"), ("steering_gain", "viscous_drag")
TRIED = [(), ("steering_dead_time",), ("steering_gain",), WRONG]


@pytest.fixture(scope="module")
def searched(drives):
    """Two alternatives fitted alone, and the wrong one beside a drag that was planted."""
    problem = problem_of(drives["two"], FEW)
    criteria = Criteria(blocks(problem.segments))
    state = State(problem, {})
    for starts in (TRIED[:1], TRIED[1:]):
        state, _ = tried_too(state, [problem.library.hypothesis(e) for e in starts], criteria)
    return state, criteria


def starts_of(state, rules=DEFAULTS):
    return swap_starts(state.problem.library, state.tried[WRONG], state.tried, rules)


def test_an_alternative_that_was_near_alone_starts_beside_the_rest_from_where_both_were(searched):
    state, _ = searched
    [start] = starts_of(state)
    assert start.effects == RIGHT
    gain = state.tried["steering_gain",].fit.values()["steering_gain"]
    drag = state.tried[WRONG].fit.values()["viscous_drag"]
    assert start.values()["steering_gain"] == gain
    assert start.values()["viscous_drag"] == drag


def test_an_alternative_that_leaves_far_more_is_not_swapped_in(searched):
    # Alone the gain leaves less than the dead time does: nothing is nearer than that.
    state, _ = searched
    assert starts_of(state, replace(DEFAULTS, swap_near=-1.0)) == []


def test_a_single_effect_is_not_swapped(searched):
    state, criteria = searched
    single = state.tried["steering_gain",]
    assert swap_starts(state.problem.library, single, state.tried, DEFAULTS) == []
    assert swapped(state, single, criteria) == (state, single)


def test_the_better_alternative_is_swapped_in_and_not_tried_again(searched):
    state, criteria = searched
    wrong = state.tried[WRONG]
    state, better = swapped(state, wrong, criteria)
    assert better.effects == RIGHT
    assert swapped(state, better, criteria)[1] is better
    assert starts_of(state) == []
    # Nor need it be: what was tried on the way is better as well.
    assert swapped(state, wrong, criteria)[1] is better


def test_an_alternative_that_is_not_accepted_is_not_swapped_in(searched):
    state, criteria = searched
    wrong = state.tried[WRONG]
    strict = replace(criteria, usual=BaselineMisfit(mean=0.0, error=1e9))
    state, best = swapped(state, wrong, strict)
    assert best is wrong
    # It was tried all the same: the confidence knows how near it came.
    assert RIGHT in state.tried
