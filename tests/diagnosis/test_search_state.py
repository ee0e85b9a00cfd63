"""What a search has tried, and how it is carried over to another noise model."""

import pickle
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.diagnosis.search.result import State, renoised, restarted, restarts, tried_too
from buggy_rl.effects import effect_class
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.gauss_newton import fitted
from buggy_rl.estimation.rollout import ALONE
from buggy_rl.estimation.workers import Workers
from tests.diagnosis.planted import problem_of

FEW = ["steering_dead_time", "steering_gain", "viscous_drag"]


def state_of(recordings, *sets):
    problem = problem_of(recordings, FEW)
    criteria = Criteria(blocks(problem.segments))
    starts = [problem.library.hypothesis(effects) for effects in ((), *sets)]
    return tried_too(State(problem, {}), starts, criteria)[0], criteria


def test_of_two_fits_of_the_same_effects_the_better_one_is_kept(drives):
    state, criteria = state_of(drives["late"], ("steering_dead_time",))
    fit = state.tried["steering_dead_time",].fit
    poor = fit.at(torch.zeros_like(fit.vector))
    again, [kept] = tried_too(state, [poor], criteria)
    assert state.loss(kept) <= state.loss(state.tried["steering_dead_time",]) + 1e-6
    assert again.tried["steering_dead_time",] is kept


def test_under_another_noise_model_what_was_tried_keeps_its_numbers(drives):
    state, criteria = state_of(drives["late"], ("steering_dead_time",), ("viscous_drag",))
    best = state.tried["steering_dead_time",]
    other = renoised(state, best, criteria)
    assert set(other.tried) == set(state.tried)
    for key, candidate in other.tried.items():
        assert torch.equal(candidate.fit.vector, state.tried[key].fit.vector)
        # Whitened anew without a rollout, it is what a rollout would give.
        [rolled] = other.problem.whitened([(candidate.fit, candidate.fit.vector)])
        torch.testing.assert_close(candidate.fit.whitened, rolled, rtol=1e-4, atol=1e-3)


def test_a_restart_finds_the_way_out_of_a_valley(drives):
    state, _ = state_of(drives["late"], ("steering_dead_time",))
    problem, fit = state.problem, state.tried["steering_dead_time",].fit
    planted = 0.06 / effect_class("steering_dead_time").declared[0].size
    stuck = problem.rolled_out([fit.at(torch.tensor([planted - 0.3, 0.0]))])[0]
    found = restarted(problem, stuck, problem.rolled_out(restarts(stuck, [-0.3, 0.3])))
    assert problem.cost(found) < problem.cost(stuck)
    assert float(found.vector[0]) == pytest.approx(planted)
    # From the best there is none, but for a right clock.
    start = restarted(problem, fit, problem.rolled_out(restarts(fit, [-0.3, 0.3])))
    assert torch.equal(start.vector[:-1], fit.vector[:-1])


@pytest.mark.parametrize(
    ("name", "expected"),
    [("late", ("steering_dead_time",)), pytest.param("nothing", (), marks=pytest.mark.slow)],
)
def test_an_effect_that_means_nothing_is_fitted_and_is_not_the_most_evident(drives, name, expected):
    decoy = f"{Path(__file__).parent / 'decoy.py'}:Decoy"
    problem = problem_of(drives[name], ["steering_dead_time", decoy])
    found = joint_search(problem, Criteria(blocks(problem.segments)))
    # With three free numbers it follows a part of any residual.
    assert (decoy,) in {w.candidate.key for w in found.weighed}
    price = 3.0  # [nats] of an effect more

    def priced(weighed):
        return weighed.evidence.log_evidence - price * len(weighed.candidate.effects)

    assert max(found.weighed, key=priced).candidate.key == expected


def test_the_same_recordings_give_the_same_fit(drives):
    # Not the fits of `late`: those may have been made without the compiled kernels.
    starts = [("steering_dead_time",), ("steering_gain",)]
    firsts, seconds = (
        fitted(problem, [problem.library.hypothesis(effects) for effects in starts])
        for problem in (problem_of(drives["late"]) for _ in range(2))
    )
    for first, second in zip(firsts, seconds, strict=True):
        assert torch.equal(first.vector, second.vector)
        assert torch.equal(first.whitened, second.whitened)


class Sending:
    """Two processes, of which what is sent to the other one is run here."""

    count = 2

    def busy(self, environments):
        return 1

    def results(self, function, arguments, seconds):
        return [pickle.loads(pickle.dumps(function))(*each) for each in arguments]


def test_sets_are_fitted_apart_beside_a_baseline_and_a_bar(drives):
    problem = problem_of(drives["late"])[torch.arange(3)]
    shown = []
    simulation = replace(
        problem.simulation,
        make=Maker("single_track"),
        workers=Sending(),
        rolled=lambda environments, rows: shown.append(environments),
    )
    problem = replace(problem, simulation=simulation)
    criteria = Criteria(blocks(problem.segments), baseline=problem)
    criteria = replace(criteria, rules=replace(criteria.rules, iterations=1), anew=False)
    names = ["steering_dead_time", "steering_gain", "steering_lag", "throttle_gain"]
    starts = [problem.library.hypothesis((name,)) for name in names]
    _, found = tried_too(State(problem, {}), starts, criteria)
    assert [c.key for c in found] == [(name,) for name in names]
    assert shown  # the bar hears of rollouts of the other process


@pytest.mark.slow
def test_sets_fitted_in_two_processes_are_those_fitted_in_one(drives):
    problem = problem_of(drives["late"])
    names = ["steering_dead_time", "steering_gain", "steering_lag", "throttle_gain"]
    starts = [problem.library.hypothesis((name,)) for name in names]
    criteria = Criteria(blocks(problem.segments))
    found = []
    with Workers(2) as two:
        for workers in (ALONE, two):
            simulation = replace(problem.simulation, make=Maker("single_track"), workers=workers)
            state = State(replace(problem, simulation=simulation), {})
            state, [null] = tried_too(state, [problem.library.hypothesis(())], criteria)
            found.append(tried_too(state, starts, criteria, null)[1])
    assert [c.key for c in found[0]] == [c.key for c in found[1]] == [(name,) for name in names]
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one.fit.vector, other.fit.vector, atol=1e-3, rtol=1e-3)
