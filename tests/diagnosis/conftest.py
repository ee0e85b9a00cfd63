"""Short drives of single-track cars, one batch of them for all tests."""

import pytest

from tests.diagnosis.planted import PLANTED, fitter, planted_drives


@pytest.fixture(scope="session")
def drives():
    """What is planted -> its drives."""
    return dict(zip(PLANTED, planted_drives(list(PLANTED.values())), strict=True))


@pytest.fixture(scope="session")
def late(drives):
    """A fit to late steering, by its cause and by another."""
    fit = fitter(drives["late"])
    return fit, fit.fit([fit.start(["steering_dead_time"]), fit.start(["steering_gain"])])
