"""The simulator's own parameters, fitted all at once."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis.answer import retuning
from buggy_rl.diagnosis.answer.retuning import retuned, wrong_parameters
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.repair.validation import Validation, validated
from buggy_rl.diagnosis.run.budget import FULL
from buggy_rl.diagnosis.run.case import (
    Criteria,
    DiagnosisCase,
    Drives,
    Retuned,
    longer_segments,
)
from buggy_rl.estimation.evidence import blocks, misfit
from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import planted_drives, problem_of

FEW = ["steering_gain"]

FITTED = ("drive_force", "left_angle", "viscous_friction", "rear_grip")


@pytest.fixture(scope="module")
def case():
    # Of four parameters two are off: 10 N and 0.45 rad in the simulator.
    recordings = planted_drives([{"parameter": {"drive_force": 7.0, "left_angle": 0.38}}])[0]
    problem = problem_of(recordings, FEW, FITTED)
    longer = longer_segments(recordings, 1.0)
    drives = Drives(recordings, problem.segments, longer)
    return DiagnosisCase(problem, Criteria(blocks(problem.segments)), drives)


@pytest.fixture(scope="module")
def tuned(case):
    return retuned(case)


@pytest.fixture(scope="module")
def named(case, tuned):
    return wrong_parameters(tuned, DEFAULTS, case.given.make(1))


@pytest.fixture(scope="module")
def again(case, tuned):
    """The same with the re-tuned simulator."""

    def make(cars):
        return make_engine("single_track", cars, parameters=tuned.values)

    declared = {name: make(1).declared[name] for name in FITTED}
    library = Library(FEW, declared, own=False)
    given = case.problem.simulation
    problem = replace(case.problem, simulation=replace(given, make=make), library=library)
    return replace(case, problem=problem, retuned_from=given)


def test_the_parameters_that_were_off_are_named_and_no_others(tuned, named):
    assert {n.name for n in named} == {
        "parameter:drive_force",
        "parameter:left_angle",
    }
    assert tuned.values["drive_force"] == pytest.approx(7.0, rel=0.02)
    assert tuned.values["left_angle"] == pytest.approx(0.38, rel=0.02)
    assert set(tuned.values) == set(FITTED)


def test_a_wrong_parameter_is_described_with_its_interval(named):
    force = next(n for n in named if n.name == "parameter:drive_force")
    assert force.sentence.startswith("the simulator's drive force is 7")
    value = force.parameters["drive_force"]
    assert value.low < value.value < value.high
    assert value.high - value.low < 0.2 * value.value


def test_fitted_parameters_are_not_in_the_library():
    declared = {"mass": make_engine("single_track", 1).declared["mass"]}
    assert Library([], declared).names == ["parameter:mass"]
    assert Library([], declared, own=False).names == []
    assert Library([], declared, own=False).numbers("parameter:mass")[0].unit == "kg"


def test_a_hypothesis_about_the_re_tuned_simulator_is_one_about_the_simulator_as_given(case, again):
    problem = again.problem
    best = problem.library.hypothesis(["steering_gain"], [0.7, 0.3])
    [expected] = problem.whitened([(best, best.vector)])
    own = again.about_given(best)
    assert own.effects == ("steering_gain", *(f"parameter:{name}" for name in FITTED))
    [found] = replace(case.problem, library=again.as_given).whitened([(own, own.vector)])
    assert float((found - expected).abs().max()) < 0.02  # of the noise
    assert float(expected.abs().max()) > 10


def test_re_tuned_parameters_are_fitted_anew_without_the_held_out_recordings(case, again):
    # Numbers that have seen all recordings, spoiled: they come back from what is not held out.
    best = again.about_given(again.problem.library.hypothesis([]))
    at = {c.parameter.name: i for i, c in enumerate(best.coordinates)}
    best.vector[at["drive_force"]] *= 0.9
    problem = replace(case.problem, library=again.as_given)
    _, errors = validated(Validation(problem, case.drives.longer), best)
    assert errors["after"].median[1.0] < 0.1 * errors["before"].median[1.0]
    assert misfit(errors["after"].square) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow  # test_pipeline has what a deadline leaves out
def test_a_small_budget_tells_no_errors_beyond_its_segments(case):
    best = case.problem.library.hypothesis(["steering_gain"], [0.5, 0.0])
    less = replace(FULL, longer=False, iterations=1)
    _, errors = validated(Validation(case.problem, case.drives.longer, less), best)
    assert {name: max(e.median) for name, e in errors.items()} == dict.fromkeys(errors, 1.0)
    assert len(errors["after"].square) == len(case.problem.segments)


def sides(left, right, covariance):
    """Two fitted steering angles at full lock, with their covariance."""
    names = ("left_angle", "right_angle", "drive_force")
    declared = {name: make_engine("single_track", 1).declared[name] for name in names}
    start = Library([], declared).hypothesis([f"parameter:{name}" for name in names])
    vector = torch.tensor([left, right, 0.0, 0.0])
    fit = Hypothesis(start.effects, start.coordinates, vector)
    known = torch.diag(torch.tensor([1.0, 1.0, 1.0, 1.0]))
    known[:2, :2] = torch.tensor(covariance)
    return Retuned(fit, known)


def wrong(left, right, covariance):
    return retuning._moved(sides(left, right, covariance), DEFAULTS)


def test_sides_that_certainly_differ_are_wrong_though_neither_is_known_well():
    # Each is known to 0.5 of its size, their difference to 0.14.
    together = [[0.25, 0.24], [0.24, 0.25]]
    found = {n.name: n.sentence for n in wrong(-0.3, 0.6, together)}
    assert set(found) == {"parameter:left_angle", "parameter:right_angle"}
    assert all(s.endswith("left and right certainly differ") for s in found.values())
    # What is as uncertain as each of them is no difference; nor is what both have moved by.
    assert wrong(-0.3, 0.6, [[0.25, 0.0], [0.0, 0.25]]) == []
    assert wrong(0.6, 0.6, together) == []
