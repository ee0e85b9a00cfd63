"""The simulator's own parameters, fitted all at once."""

import pytest

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.library import Library
from buggy_rl.diagnosis.retuning import retuned
from buggy_rl.engines import make_engine
from tests.diagnosis.planted import fitter, planted_drives

FITTED = ("drive_force", "left_angle", "viscous_friction", "rear_grip")


@pytest.fixture(scope="module")
def tuned():
    # Of four parameters two are off: 10 N and 0.45 rad in the simulator.
    recordings = planted_drives([{"parameter": {"drive_force": 7.0, "left_angle": 0.38}}])[0]
    fit = fitter(recordings, [], FITTED)
    names = [recording.name for recording in recordings]
    case = Case(fit.player, fit.cut, fit.likelihood, fit.library, names, recordings)
    return retuned(case)


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
    declared = {"mass": make_engine("single_track", 1).parameters["mass"]}
    assert Library([], declared).causes == ["parameter:mass"]
    assert Library([], declared, own=False).causes == []
    assert Library([], declared, own=False).numbers("parameter:mass")[0].unit == "kg"
