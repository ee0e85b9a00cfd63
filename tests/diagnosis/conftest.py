"""Short drives of single-track cars, one batch of them for all tests, and shared diagnoses."""

from dataclasses import replace

import pytest

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.estimation.gauss_newton import fitted
from tests.canned import canned
from tests.diagnosis.planted import PLANTED, planted_drives, problem_of

ASKED = DiagnosisConfig(
    simulator="single_track",
    recordings=["made in the test"],
    output="nowhere",
    effects=["throttle_gain", "viscous_drag", "gyro_bias"],
    parameters=False,
    stretches=24,
    minutes=0.0,  # however busy the machine is, the same search
    workers=1,  # other tests have the other cores
)
"""The question of the shared diagnoses."""
SMALL = replace(ASKED, effects=["throttle_gain", "viscous_drag"], stretches=8)
"""A quick one, where it matters how an answer is come to and not which."""
LONG = {"weak": {"throttle_gain": {"gain": 0.7}}, "nothing": {}}
"""What is planted in their drives."""


@pytest.fixture(scope="session")
def drives():
    """What is planted -> its drives."""
    return dict(zip(PLANTED, planted_drives(list(PLANTED.values())), strict=True))


@pytest.fixture(scope="session")
def late(drives):
    """A problem with late steering, fitted by its effect and by another."""
    problem = problem_of(drives["late"])
    starts = [problem.library.hypothesis([e]) for e in ("steering_dead_time", "steering_gain")]
    return problem, fitted(problem, starts)


@pytest.fixture(scope="session")
def long_drives():
    """What is planted -> three drives of 18 s."""
    made = planted_drives(list(LONG.values()), seconds=18.0)
    return dict(zip(LONG, made, strict=True))


@pytest.fixture(scope="session")
def weak(long_drives, canned_folder):
    """The diagnosis of a car with a weak throttle."""
    return canned(canned_folder, ASKED, long_drives["weak"])


@pytest.fixture(scope="session")
def right(long_drives, canned_folder):
    """The diagnosis of a car that is as the simulator says."""
    return canned(canned_folder, SMALL, long_drives["nothing"])


@pytest.fixture(scope="session")
def small(long_drives, canned_folder):
    """The quick diagnosis of a car with a weak throttle."""
    return canned(canned_folder, SMALL, long_drives["weak"])
