"""Which effects are said as one finding: those whose predictions the recordings cannot tell."""

from dataclasses import replace

import pytest

from buggy_rl.diagnosis.answer.equivalents import (
    alike,
    apart,
    equivalents,
    probability_of_any,
    swapped,
)
from buggy_rl.diagnosis.answer.named_effect import name_effect
from buggy_rl.diagnosis.answer.statement import confidences
from buggy_rl.diagnosis.run.case import Criteria, DiagnosisCase, Drives, longer_segments
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.diagnosis.search.observed import concluded
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.effects import effect_class
from buggy_rl.estimation.evidence import blocks
from tests.diagnosis.planted import planted_drives, problem_of

# Without restored range a deadband is a trim of the radio, but for the least of drives.
TRIM, BAND, STEERING = ("throttle_offset",), ("throttle_deadband",), ("steering_gain",)
LEAST = 10.0  # [nats]


@pytest.fixture(scope="module")
def case():
    recordings = planted_drives([{"throttle_offset": {"offset": -0.1}}], cars=2, seconds=10.0)[0]
    problem = problem_of(recordings, [*TRIM, *BAND, *STEERING])
    longer = longer_segments(recordings, 1.0)
    drives = Drives(recordings, problem.segments, longer)
    return DiagnosisCase(problem, Criteria(blocks(problem.segments)), drives)


@pytest.fixture(scope="module")
def found(case):
    searched = joint_search(case.problem, case.criteria, also=[TRIM, BAND, STEERING])
    result = concluded(case.criteria, searched)
    return replace(
        result,
        best=result.tried[TRIM],
        posterior=Posterior({(): 0.01, TRIM: 0.5, BAND: 0.4, STEERING: 0.05}, 0.04),
    )


def test_a_trim_and_a_deadband_predict_the_same_and_a_steering_gain_does_not(found):
    trim, band, steering = (found.tried[e] for e in (TRIM, BAND, STEERING))
    assert apart(found, trim, trim) == 0
    assert apart(found, trim, band) < LEAST
    assert apart(found, trim, steering) > 10 * LEAST
    # |r_A - r_B|^2 / (2 phi), and so a half of it at twice the dispersion
    less = replace(found, dispersion=2 * found.dispersion)
    assert apart(less, trim, band) == pytest.approx(0.5 * apart(found, trim, band))


def test_only_what_cannot_be_told_from_a_named_effect_is_merged_with_it(found):
    assert list(alike(found, *TRIM, LEAST)) == list(BAND)
    assert alike(found, *TRIM, 0.0) == {}
    faint = replace(found, posterior=Posterior({TRIM: 0.95, BAND: 0.01}, 0.04))
    assert alike(faint, *TRIM, LEAST) == {}  # below 2 % none is listed
    assert swapped(found, *TRIM, "wind") is None  # that was never fitted


def test_their_joint_probability_is_that_of_all_sets_with_any_of_them(found):
    assert probability_of_any(found, [*TRIM, *BAND]) == pytest.approx(0.9)
    both = replace(found, posterior=Posterior({TRIM: 0.5, (*BAND, *TRIM): 0.3}, 0.2))
    assert probability_of_any(both, [*TRIM, *BAND]) == pytest.approx(0.8)


def test_they_are_said_as_one_finding_while_neither_is_sure(case, found):
    def findings(posterior):
        now = replace(found, posterior=posterior)
        named = name_effect(case, now, *TRIM, confidences(now, posterior)[TRIM[0]])
        return equivalents(case, now, [named], [])

    [either] = findings(found.posterior)
    assert either.effects == (*TRIM, *BAND)
    assert either.shares == (0.5, 0.4)
    assert either.probability == pytest.approx(0.9)
    assert "throttle acts as if it were" in either.sentences[0]
    assert "of the throttle do nothing" in either.sentences[1]
    assert either.decided_by == ""
    assert findings(Posterior({TRIM: 0.93, BAND: 0.03}, 0.04)) == []


def test_where_no_effect_describes_it_the_set_that_predicts_best_stands_for_the_car(found):
    # The steering gain is the most probable set, of hardly any probability, and predicts nothing.
    unknown = Posterior({(): 0.01, STEERING: 0.02, TRIM: 0.01}, 0.96)
    now = replace(found, best=found.tried[STEERING], posterior=unknown)
    assert now.predictive.key != STEERING
    assert now.loss(now.predictive) < now.loss(now.best)
    assert now.described is now.predictive
    assert replace(now, posterior=Posterior({STEERING: 0.9}, 0.1)).described is now.best


def test_an_unusually_large_number_is_at_most_even_without_a_baseline(case, found, monkeypatch):
    sure = Posterior({TRIM: 0.95}, 0.05)
    now = replace(found, posterior=sure)

    def named(of):
        return name_effect(of, now, *TRIM, confidences(now, sure)[TRIM[0]])

    assert named(case).confidence == pytest.approx(0.95)
    kind = effect_class(*TRIM)
    small = tuple(replace(p, usual=(-0.01, 0.01)) for p in kind.declared)
    monkeypatch.setattr(kind, "declared", small)
    assert named(case).unusual == ("offset",)
    assert named(case).confidence == 0.5
    known = replace(case, criteria=replace(case.criteria, baseline=case.problem))
    assert named(known).confidence == pytest.approx(0.95)
    assert named(known).unusual == ("offset",)
