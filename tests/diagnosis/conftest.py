"""Short drives of single-track cars, one batch of them for all tests."""

import pytest

from buggy_rl.estimation.gauss_newton import fitted
from tests.diagnosis.planted import PLANTED, planted_drives, problem_of


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
