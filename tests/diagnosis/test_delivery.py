"""What is delivered was validated: `repaired.yaml` rolls out to the numbers of the answer."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
import yaml
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.repair.proof import Repair, chosen, is_worse, repair_candidates
from buggy_rl.diagnosis.repair.validation import Errors, Validation, delivered, validated
from buggy_rl.diagnosis.repaired import repaired_simulator
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.estimation.gauss_newton import fitted
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.recordings import Recording
from buggy_rl.task.env import make_simulator
from tests.diagnosis.planted import planted_drives, problem_of

EARLY = 6  # rows by which commands are stamped late: they act 60 ms earlier than they say
CONFIG = DiagnosisConfig(
    simulator="single_track",
    recordings=["made in the test"],
    output="nowhere",
    effects=["throttle_gain", "viscous_drag"],
    parameters=False,
    stretches=16,
    minutes=0.0,
    workers=1,
)


def stamped_late(recording, rows=EARLY):
    data = recording.data
    late = TensorDict(
        {key: value[: len(data) - rows] for key, value in data.items()}, [len(data) - rows]
    )
    late[keys.POSE], late[keys.VELOCITY] = data[keys.POSE][rows:], data[keys.VELOCITY][rows:]
    return Recording(recording.name, late, recording.dt)


@pytest.fixture(scope="module")
def recordings():
    made = planted_drives([{"throttle_gain": {"gain": 0.6}}], seconds=9.0)[0]
    return [stamped_late(recording) for recording in made]


@pytest.fixture(scope="module")
def done(recordings):
    return run_diagnosis(CONFIG, recordings)


def median(square):
    return float(square.mean(-1).sqrt().median())


def test_the_file_rolls_out_to_the_numbers_that_are_printed(done, tmp_path):
    offset = done.found.best.fit.values()[""]["clock_offset"]
    assert offset < -0.03  # or the case shows nothing
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(repaired_simulator(CONFIG.simulator, done, tmp_path)))
    segments = done.case.problem.segments
    [residual] = Simulation(lambda cars: make_simulator(file, cars)).residuals(segments)
    own = median(residual[..., :2].square().sum(-1))
    assert done.answer.repair.median[1.0] == pytest.approx(own, rel=1e-3)
    # Held out, each half is rolled out with numbers of the other: near, not equal.
    assert done.answer.proof.median["after"][1.0] == pytest.approx(own, rel=0.3)
    said = (*done.answer.effects, *done.answer.terms)
    assert done.answer.repair.effects == tuple(e.name for e in said)


def test_the_errors_are_of_commands_as_they_are_stamped(recordings):
    problem = problem_of(recordings, ["throttle_gain"])
    [fit] = fitted(problem, [problem.library.hypothesis(["throttle_gain"])])
    assert float(fit.vector[-1]) < -3  # prior scales of 10 ms
    _, errors = validated(Validation(problem), fit)
    file = delivered(problem, fit)
    assert [c.effect for c in file.fit.coordinates] == ["throttle_gain"]
    with_clock = problem.simulation.residuals(
        problem.segments, problem.library.settings([(fit, fit.vector)])
    )
    left = median(with_clock[0, ..., :2].square().sum(-1))
    assert errors["after"].median[1.0] > 1.5 * left  # no file can hold that clock
    assert errors["after"].median[1.0] == pytest.approx(file.errors.median[1.0], rel=0.3)


def errors_of(distance, square):
    return Errors({1.0: distance**2}, {1.0: distance}, torch.full((9,), square))


def test_what_makes_held_out_rollouts_worse_is_not_delivered():
    before, worse, better = errors_of(0.057, 9.0), errors_of(0.060, 8.0), errors_of(0.04, 6.0)
    assert is_worse(worse, before)  # by the distance
    assert is_worse(errors_of(0.05, 10.0), before)  # by the misfit
    assert not is_worse(better, before)
    assert chosen({"before": before, "after": worse}, unknown=False) == "before"
    assert chosen({"before": before, "after": worse, "other": better}, unknown=False) == "other"
    fair = errors_of(0.05, 7.0)
    every = {"before": before, "after": fair, "other": better}
    assert chosen(every, unknown=False) == "after"  # what is named is what is delivered
    assert chosen(every, unknown=True) == "other"  # what predicts best is


def test_where_no_effect_describes_it_the_set_that_predicts_best_is_validated_first():
    probable, best = SimpleNamespace(key=("wind",)), SimpleNamespace(key=("payload", "wind"))
    found = SimpleNamespace(best=probable, predictive=best, posterior=Posterior({}, 1.0))
    assert repair_candidates(found) == [best, probable]
    found.posterior = Posterior({("wind",): 0.9}, 0.1)
    assert repair_candidates(found) == [probable, best]
    found.posterior = Posterior({(): 0.9}, 0.1)
    assert repair_candidates(found) == [probable]
    found = replace_best(found, probable)
    assert repair_candidates(found) == [probable]


def replace_best(found, predictive):
    return SimpleNamespace(
        best=found.best, predictive=predictive, posterior=Posterior({("wind",): 0.9}, 0.1)
    )


def test_a_refused_repair_and_one_beyond_what_is_named_are_said():
    refused = Repair(refused=("wind",), worse=(0.057, 0.060))
    assert refused.lines(("wind",)) == [
        "repaired.yaml is the simulator as given: wind would make held-out rollouts worse (median "
        "position error 57 mm without, 60 mm with it)."
    ]
    written = Repair({"wind": {"force_x": 0.1}, "parameter:mass": {"mass": 1.0}})
    assert written.lines(("wind",)) == []
    [line] = written.lines(())
    assert line.startswith("repaired.yaml has wind: the set that predicts")


def test_a_hypothesis_as_stamped_has_all_numbers_but_the_clocks():
    problem = problem_of(planted_drives([{}], cars=1, seconds=4.0)[0], ["throttle_gain"])
    full = problem.library.hypothesis(["throttle_gain"], [0.5, -2.0])
    settings = problem.library.settings([(full.as_stamped, full.as_stamped.vector)])
    assert settings.clock_offset.tolist() == [0.0]
    assert full.as_stamped.values() == {"throttle_gain": full.values()["throttle_gain"]}
    assert replace(full, vector=full.vector).values()[""]["clock_offset"] == pytest.approx(-0.02)


def test_a_name_that_equations_make_needless_is_said_to_be_gone():
    term = "term.yaw.throttle.even_square"
    repair = Repair({term: {"coefficient": 3.0}, "throttle_gain": {"gain": 0.9}})
    [line] = repair.lines(("throttle_gain", "steering_offset"))
    assert "has no steering_offset" in line
    assert "has no" not in repair.lines(("throttle_gain",))[0]
