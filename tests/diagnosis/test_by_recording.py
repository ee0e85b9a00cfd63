"""A car that differs from recording to recording."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.by_recording import by_recording
from buggy_rl.diagnosis.search.result import State, tried_too
from buggy_rl.estimation.evidence import blocks, misfit
from buggy_rl.estimation.noise_model import noise_model
from tests.diagnosis.planted import planted_drives, problem_of

LIBRARY = ["steering_gain", "steering_offset", "viscous_drag", "yaw_damping", "grip_patch"]
NAMES = ["first", "second"]


@pytest.fixture(scope="module")
def drives():
    gains = [{"steering_gain": {"gain": gain}} for gain in (1.06, 0.95)]
    return planted_drives([{}, *gains], cars=2, seconds=20.0)


def looked_at(recordings, effects=()):
    """What differs, by a problem of recordings and about a set of effects."""
    problem = problem_of(recordings, LIBRARY)
    criteria = Criteria(blocks(problem.segments))
    starts = [problem.library.hypothesis(()), problem.library.hypothesis(effects)]
    _, [null, best] = tried_too(State(problem, {}), starts, criteria)
    return problem, by_recording(criteria, problem, null, best, NAMES)


def test_an_effect_that_differs_is_found_with_its_number_in_each_recording(drives):
    _, (low, _), (high, _) = drives
    _, found = looked_at([low, high])
    [difference] = found.differences
    assert difference.effect == "steering_gain"
    assert difference.numbers["first"]["gain"] == pytest.approx(1.06, abs=0.002)
    assert difference.numbers["second"]["gain"] == pytest.approx(0.95, abs=0.002)
    assert difference.closes > 0.8
    assert difference.words().startswith("steering_gain (gain 1.06 in first, gain 0.95 in second")
    assert difference.to_dict()["units"] == {"gain": "-"}


@pytest.mark.parametrize("case", [0, 1])
def test_nothing_differs_in_two_recordings_of_one_car(drives, case):
    _, found = looked_at(drives[case])
    assert found.differences == ()
    assert found.covariance is None


def test_nothing_is_looked_for_in_a_single_recording(drives):
    assert looked_at(drives[1][:1])[1].covariance is None


def test_what_differs_is_no_residual_under_its_covariance(drives):
    _, (low, _), (high, _) = drives
    problem, found = looked_at([low, high])
    assert found.covariance is not None
    assert found.covariance.shape == (len(problem.segments), *[problem.noise.dimension] * 2)
    assert (torch.linalg.matrix_rank(found.covariance) <= 1).all()  # of one number

    def left(extra):
        noise = noise_model(problem.simulation, problem.segments, extra=extra)
        square = noise.whiten(problem.simulation.residuals(problem.segments))[0].square().sum(-1)
        assert torch.equal(noise[torch.tensor([1])].whitening[0], noise.whitening[1])
        return misfit(square / noise.dimension)

    assert left(None) > 2.0
    assert left(found.covariance) < 1.3


@pytest.fixture(scope="module")
def searched_again(drives):
    _, (low, _), (high, _) = drives
    high = replace(high, name="later")
    asked = DiagnosisConfig(
        simulator="single_track",
        recordings=["made in the test"],
        output="nowhere",
        effects=["steering_gain", "viscous_drag"],
        parameters=False,
        stretches=8,
        workers=1,
    )
    return run_diagnosis(asked, [low, high])


def test_what_differs_is_said_and_is_no_physics_that_is_missing(searched_again):
    answer = searched_again.answer
    assert answer.verdict == "no_mismatch"
    [difference] = answer.to_dict()["by_recording"]
    assert difference["effect"] == "steering_gain"
    assert list(difference["numbers"]) == ["drive_0", "later"]
    said, beside, *_ = answer.lines()
    assert said.startswith("The car differs from recording to recording, as by steering_gain (")
    assert beside == "Beside that: simulator and recordings agree within the sensor noise."
