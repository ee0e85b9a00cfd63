"""Which manoeuvre decides between hypotheses that recordings at steady speed leave open."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis import experiments
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.experiments import TIMES, decided, suggestions
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.estimation.cross_validation import blocks, cross_validated
from buggy_rl.estimation.gauss_newton import fitted
from tests.diagnosis.planted import commands, planted_drives, problem_of

ENOUGH = DEFAULTS.deciding_nats
DRAGGY = {"viscous_drag": {"rate": 0.1}}
EFFECTS = ("viscous_drag", "aerodynamic_drag", "steering_gain")


def measured(action, seed=0):
    """Recordings of a car with more drag, under `action` [cars, rows, 2]."""
    return planted_drives([DRAGGY], len(action), seed=seed, action=action)[0]


def steady():
    """At one throttle and changing steering: speed hardly changes."""
    return measured(commands(2, 1500, drive=(0.3, 0.3)))


def candidate(problem, effect):
    """One effect, fitted and cross-validated."""
    [fit] = fitted(problem, [problem.library.hypothesis([effect], [0.5, 0.0])])
    [known] = cross_validated(problem, [fit], blocks(problem.segments))
    return Candidate(fit, known)


def suggested(problem, best, others):
    return suggestions(problem, best, others, ENOUGH)


@pytest.fixture(scope="module")
def undecided():
    """Steady recordings of a car that has more drag, fitted by each of three effects."""
    problem = problem_of(steady(), EFFECTS)
    return problem, [candidate(problem, effect) for effect in EFFECTS]


@pytest.fixture(scope="module")
def nats(undecided):
    """Of each manoeuvre: the first from the second, and from itself."""
    problem, (best, other, _) = undecided
    return decided(problem, best, [other, best])[0]


def named(name):
    return [m.name for m in MANOEUVRES].index(name)


def test_a_manoeuvre_decides_by_as_many_nats_as_predicted(undecided, nats):
    problem, candidates = undecided
    alone = [problem.cost(candidate.fit) for candidate in candidates[:2]]
    predicted = float(nats[0, named("slow_slalom")])
    driven = MANOEUVRES[named("slow_slalom")].actions(0.01).expand(TIMES, -1, -1)
    both = problem_of([*steady(), *measured(driven, seed=1)], EFFECTS)
    costs = [both.cost(candidate(both, effect).fit) for effect in EFFECTS[:2]]
    gained = (costs[1] - costs[0]) - (alone[1] - alone[0])
    assert predicted > ENOUGH
    assert 0.5 * predicted < gained < 2 * predicted


def test_no_manoeuvre_tells_a_hypothesis_from_itself(nats):
    assert float(nats[1].abs().max()) < 1e-6


def test_a_manoeuvre_much_faster_than_what_was_driven_decides_nothing(undecided, nats):
    problem, (best, other, _) = undecided
    assert nats[0, named("full_throttle")] == 0
    segments = problem.segments
    faster = replace(segments, smooth_velocity=2 * segments.smooth_velocity)
    problem = replace(problem, segments=faster)
    assert decided(problem, best, [other])[0][0, named("full_throttle")] > ENOUGH


def test_one_manoeuvre_is_suggested_where_one_tells_all_apart(undecided):
    problem, (best, *others) = undecided
    lines = suggested(problem, best, others)
    assert any(lines[0].startswith(m.words) for m in MANOEUVRES)
    assert "tells viscous_drag from " in lines[0]
    assert all(f"from {effect}" in " ".join(lines) for effect in EFFECTS[1:])
    assert len(lines) < 3
    assert suggested(problem, best, []) == []


def test_a_manoeuvre_outside_the_training_range_decides_nothing(undecided, monkeypatch):
    problem, (best, other, _) = undecided
    simulated = experiments._simulated

    def beyond(*given):
        recordings, outside = simulated(*given)
        return recordings, torch.ones_like(outside)

    monkeypatch.setattr(experiments, "_simulated", beyond)
    assert suggested(problem, best, [other]) == []
