"""The simulator's own parameters, fitted all at once."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis import retuning
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.retuning import retuned, with_own
from buggy_rl.diagnosis.validation import prove
from buggy_rl.engines import make_engine
from buggy_rl.estimation.cross_validation import Evidence
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import misfit
from tests.diagnosis.planted import fitter, planted_drives

FEW = ["steering_gain"]

FITTED = ("drive_force", "left_angle", "viscous_friction", "rear_grip")


@pytest.fixture(scope="module")
def case():
    # Of four parameters two are off: 10 N and 0.45 rad in the simulator.
    recordings = planted_drives([{"parameter": {"drive_force": 7.0, "left_angle": 0.38}}])[0]
    fit = fitter(recordings, FEW, FITTED)
    names = [recording.name for recording in recordings]
    return Case(fit.player, fit.cut, fit.likelihood, fit.library, names, recordings)


@pytest.fixture(scope="module")
def tuned(case):
    return retuned(case)


@pytest.fixture(scope="module")
def again(case, tuned):
    """The question asked anew with the re-tuned simulator."""

    def make(cars):
        return make_engine("single_track", cars, parameters=tuned.values)

    declared = {name: make(1).declared[name] for name in FITTED}
    library = Library(FEW, declared, own=False)
    player = replace(case.player, make=make)
    return replace(case, player=player, library=library, retuned_from=case.player)


def test_what_was_off_is_found_and_nothing_else_is_called_wrong(tuned):
    assert {named.name for named in tuned.wrong} == {
        "parameter:drive_force",
        "parameter:left_angle",
    }
    assert tuned.values["drive_force"] == pytest.approx(7.0, rel=0.02)
    assert tuned.values["left_angle"] == pytest.approx(0.38, rel=0.02)
    assert set(tuned.values) == set(FITTED)


def test_a_wrong_parameter_is_said_in_words_with_its_interval(tuned):
    force = next(n for n in tuned.wrong if n.name == "parameter:drive_force")
    assert force.sentence.startswith("the simulator's drive force is 7")
    value = force.parameters["drive_force"]
    assert value.low < value.value < value.high
    assert value.high - value.low < 0.2 * value.value


def test_parameters_that_were_fitted_are_no_causes_any_more():
    declared = {"mass": make_engine("single_track", 1).declared["mass"]}
    assert Library([], declared).causes == ["parameter:mass"]
    assert Library([], declared, own=False).causes == []
    assert Library([], declared, own=False).numbers("parameter:mass")[0].unit == "kg"


def test_an_explanation_of_the_re_tuned_simulator_is_one_of_the_simulator_as_given(case, again):
    fit = Fitter(again.player, again.cut, again.likelihood, again.library)
    best = fit.start(["steering_gain"], [0.7, 0.3])
    [expected] = fit.evaluate([(best, best.place)])
    own = with_own(again, best)
    assert own.causes == ("steering_gain", *(f"parameter:{name}" for name in FITTED))
    as_given = Fitter(case.player, case.cut, case.likelihood, again.as_given)
    [found] = as_given.evaluate([(own, own.place)])
    assert float((found - expected).abs().max()) < 0.02  # of the noise
    assert float(expected.abs().max()) > 10


def test_what_is_held_out_of_the_proof_is_held_out_of_the_re_tuning_too(case, again, tuned):
    # Numbers that have seen all drives, spoiled: fitted anew, they come back, from what is left.
    fit = Fitter(again.player, again.cut, again.likelihood, again.library)
    best = with_own(again, fit.start([]))
    at = {u.parameter.name: i for i, u in enumerate(best.unknowns)}
    best.place[at["drive_force"]] *= 0.9
    errors = prove(case.player, case.recordings, case.cut, case.likelihood, again.as_given, best)
    assert errors["after"].median[1.0] < 0.1 * errors["before"].median[1.0]
    assert misfit(errors["after"].white) == pytest.approx(1.0, abs=0.1)


def sides(left, right, covariance):
    """Two locks that were fitted, with what is known of them."""
    names = ("left_angle", "right_angle", "drive_force")
    declared = {name: make_engine("single_track", 1).declared[name] for name in names}
    library = Library([], declared)
    causes = [f"parameter:{name}" for name in names]
    fitted = Fitted(
        tuple(causes),
        library.unknowns(causes),
        torch.tensor([left, right, 0.0, 0.0]),
        torch.zeros(1, 1),
    )
    known = torch.diag(torch.tensor([1.0, 1.0, 1.0, 1.0]))
    known[:2, :2] = torch.tensor(covariance)
    return Candidate(fitted, Evidence(torch.zeros(1), known))


def test_sides_that_certainly_differ_are_wrong_though_neither_is_known_well():
    # Each is known to 0.5 of its size, their difference to 0.14.
    together = [[0.25, 0.24], [0.24, 0.25]]
    found = {n.name: n.sentence for n in retuning._wrong(sides(-0.3, 0.6, together))}
    assert set(found) == {"parameter:left_angle", "parameter:right_angle"}
    assert all(s.endswith("left and right certainly differ") for s in found.values())
    # What is as uncertain as each of them is no difference; nor is what both have moved by.
    assert retuning._wrong(sides(-0.3, 0.6, [[0.25, 0.0], [0.0, 0.25]])) == []
    assert retuning._wrong(sides(0.6, 0.6, together)) == []
