"""Faults of a user's own simulator that show in the midst of a diagnosis: one line, no crash."""

from dataclasses import replace

import pytest

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from tests.diagnosis.planted import planted_drives

pytestmark = pytest.mark.slow

FAULTY = """
import torch
from tests.plain_env import QuickCar

class Failing(QuickCar):
    def _step(self, tensordict):
        if self.batch_size[0] > 100 and bool((tensordict["velocity"][:, 2].abs() > 1.0).any()):
            raise RuntimeError("solver did not converge")
        return super()._step(tensordict)

class Hole(QuickCar):
    def _step(self, tensordict):
        after = super()._step(tensordict)
        inside = (after["pose"][:, 0].remainder(2.0) < 0.1).unsqueeze(-1)
        after["velocity"] = torch.where(inside, torch.nan, after["velocity"])
        return after

class Narrowing(QuickCar):
    def _step(self, tensordict):
        after = super()._step(tensordict)
        if self.batch_size[0] > 100:
            after["pose"] = after["pose"][:, :2]
        return after
"""
CONFIG = DiagnosisConfig(
    simulator="",
    recordings=["made in the test"],
    output="nowhere",
    effects=["throttle_gain", "steering_dead_time"],
    stretches=16,
    minutes=0.01,
    workers=1,
)


@pytest.fixture(scope="module")
def recordings():
    return planted_drives([{"throttle_gain": {"gain": 0.7}}], cars=2, seconds=14.0)[0]


@pytest.fixture
def simulator(tmp_path):
    file = tmp_path / "faulty.py"
    file.write_text(FAULTY)
    return lambda name: f"{file}:{name}"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Failing", "step raised RuntimeError: solver did not converge"),
        ("Narrowing", "simulator .*Narrowing"),
    ],
)
def test_a_fault_in_the_midst_is_blamed_on_the_simulator_in_one_line(
    recordings, simulator, name, words
):
    with pytest.raises(ValueError, match=words) as told:
        run_diagnosis(replace(CONFIG, simulator=simulator(name)), recordings)
    assert "\n" not in str(told.value)


def test_numbers_that_are_none_here_and_there_are_noted_and_the_rest_is_answered(
    recordings, simulator
):
    try:
        done = run_diagnosis(replace(CONFIG, simulator=simulator("Hole")), recordings)
    except ValueError as error:
        assert "returns NaN" in str(error)  # noqa: PT017  in more than half of the segments
    else:
        assert any("returns NaN" in note for note in done.answer.notes)
