from pathlib import Path

import pytest
import torch

from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.search import (
    State,
    relinearised,
    renoised,
    search,
    tried_too,
    warm_started,
)
from buggy_rl.diagnosis.selection import Criteria
from buggy_rl.effects import effect_class
from buggy_rl.estimation.cross_validation import blocks, cross_validated
from buggy_rl.estimation.gauss_newton import fitted, linearised
from tests.diagnosis.planted import problem_of

FEW = ["steering_dead_time", "steering_gain", "viscous_drag"]


def searched(recordings, effects):
    problem = problem_of(recordings, effects)
    return search(problem, Criteria(blocks(problem.segments)))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nothing", ()),
        ("late", ("steering_dead_time",)),
        ("two", ("steering_gain", "viscous_drag")),
    ],
)
def test_the_search_finds_what_was_planted_and_nothing_else(drives, name, expected):
    found = searched(drives[name], FEW)
    assert tuple(sorted(found.best.effects)) == expected
    assert found.tried[found.best.key] is found.best


def test_a_fit_that_is_stuck_is_warm_started_from_where_its_effect_came_to_beside_others(drives):
    problem = problem_of(drives["late"], FEW)
    criteria = Criteria(blocks(problem.segments))
    state, _ = tried_too(State(problem, {}), [problem.library.hypothesis(())], criteria)
    planted = 0.06 / effect_class("steering_dead_time").declared[0].size
    starts = [
        problem.library.hypothesis(["steering_dead_time"], [0.1 * planted, 0.0]),
        problem.library.hypothesis(["steering_dead_time", "viscous_drag"], [1.2 * planted, 0, 0]),
    ]
    fits = linearised(problem, problem.rolled_out(starts))  # neither is fitted any further
    known = cross_validated(problem, fits, criteria.group)
    tried = dict(state.tried)
    for fit, validated in zip(fits, known, strict=True):
        tried[fit.effects] = Candidate(fit, validated)
    base = tried["steering_dead_time",]
    state, better = warm_started(State(problem, tried), base, criteria)
    assert better is not None
    assert better.effects == base.effects
    assert state.loss(better) < state.loss(base)
    assert float(better.fit.vector[0]) == pytest.approx(planted, rel=0.05)
    assert warm_started(state, better, criteria)[1] is None  # no vector beside others is better


def test_an_effect_that_is_not_in_the_library_is_not_mended_by_one_that_is(drives):
    found = searched(drives["draggy"], ["steering_dead_time", "gyro_bias"])
    assert found.best.effects == ()
    assert found.dispersion > 1.5  # and what it leaves is counted as dispersion


@pytest.mark.parametrize(("name", "expected"), [("nothing", ()), ("late", ("steering_dead_time",))])
def test_an_effect_that_means_nothing_is_not_accepted(drives, name, expected):
    decoy = f"{Path(__file__).parent / 'decoy.py'}:Decoy"
    found = searched(drives[name], [*FEW, decoy])
    assert found.best.effects == expected
    # It was fitted: with three free numbers it follows a part of any residual.
    assert (decoy,) in found.tried


def test_the_same_recordings_give_the_same_fit(late):
    problem, (right, wrong) = late
    starts = [problem.library.hypothesis([e]) for e in ("steering_dead_time", "steering_gain")]
    for first, second in zip((right, wrong), fitted(problem, starts), strict=True):
        assert torch.equal(first.vector, second.vector)
        assert torch.equal(first.whitened, second.whitened)


def test_after_relinearising_a_nat_counts_by_a_quarter_of_what_the_hypothesis_leaves(drives):
    problem = problem_of(drives["late"], ["gyro_bias"])  # which is not what is planted
    criteria = Criteria(blocks(problem.segments))
    starts = [problem.library.hypothesis(effects) for effects in ((), ("gyro_bias",))]
    state, [_, wrong] = tried_too(State(problem, {}), starts, criteria)
    left = renoised(state, wrong, criteria).tried[wrong.key].typical
    polished, _ = relinearised(state, wrong, criteria)
    assert polished.problem.dispersion == pytest.approx(0.25 * left)
    assert polished.problem.dispersion > 1.0
