"""Short recordings of single-track cars, one batch of them for all tests."""

import pytest

from tests.diagnosis.planted import planted_drives

PLANTED = {
    "nothing": {},
    "before": {},
    "offset": {"steering_offset": {"offset": 0.15}},
    "draggy": {"viscous_drag": {"rate": 0.8}},
    "weak": {"parameter": {"drive_force": 7.0}},
    "late": {"steering_dead_time": {"dead_time": 0.11}},
    "two": {"viscous_drag": {"rate": 0.8}, "steering_gain": {"gain": 0.8}},
}


@pytest.fixture(scope="session")
def drives():
    """What is planted -> two drives of 13 s."""
    made = planted_drives(list(PLANTED.values()), cars=2, seconds=13.0, seed=3)
    return dict(zip(PLANTED, made, strict=True))


@pytest.fixture
def answering(monkeypatch):
    """A method of a module, given its columns instead of a case."""

    def bound(module, method):
        def say(found):
            monkeypatch.setattr(f"{module}.open_question", lambda seen: seen)
            monkeypatch.setattr(f"{module}.residual_columns", lambda seen: found)
            return method(None)

        return say

    return bound
