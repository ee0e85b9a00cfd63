"""The time of a rollout is measured, not guessed; here on a clock that the simulation moves."""

import types
from dataclasses import dataclass, field
from typing import Any

import pytest

from buggy_rl.estimation import cost
from buggy_rl.estimation.cost import measured_cost
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.planted import QUIET, planted_drives

FIXED, EACH, EFFECT, RESET = 0.01, 2e-4, 1e-3, 0.2  # [s]
NAMES = ["steering_gain", "viscous_drag", "sensor_latency", "steering_backlash"]


class Clock:
    now = 0.0

    def perf_counter(self):
        return self.now


@dataclass(frozen=True)
class Simulated:
    """A step takes 10 ms, 0.2 ms for each environment and 1 ms for each effect; a reset 0.2 s."""

    clock: Clock
    workers: Any = field(default_factory=lambda: types.SimpleNamespace(count=2))
    rolled: Any = None

    def make(self, environments):
        return self

    def reset(self):
        self.clock.now += RESET

    def readings(self, segments, settings):
        self.reset()
        rows, environments = segments.pose.shape[1] - 1, len(segments) * len(settings)
        self.clock.now += rows * (FIXED + EACH * environments + EFFECT * len(settings.effects))


@pytest.fixture
def simulated(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(cost, "time", clock)
    return Simulated(clock)


@pytest.fixture(scope="module")
def short():
    return cut_segments(planted_drives([{}], 1, 5.0, quality=QUIET)[0], 1.0, 1.0).shortened(10)


def test_fixed_time_time_of_each_environment_and_of_a_reset_are_told_apart(simulated, short):
    measured = measured_cost(simulated, short, [])
    assert measured.fixed == pytest.approx(FIXED)
    assert measured.each == pytest.approx(EACH)
    assert measured.reset == pytest.approx(RESET)
    assert measured.effects == 0


def test_effects_in_the_stack_cost_time(simulated, short):
    measured = measured_cost(simulated, short, NAMES)
    assert measured.effects == pytest.approx(len(NAMES) * EFFECT)
    assert measured.seconds(100, 10, 1.0) == pytest.approx(
        measured.seconds(100, 10) + 10 * len(NAMES) * EFFECT
    )


def test_of_a_slow_simulator_what_effects_cost_is_not_timed(simulated, short, monkeypatch):
    monkeypatch.setattr(cost, "LONGEST", 0.0)
    assert measured_cost(simulated, short, NAMES).effects == 0


def test_what_a_rollout_takes_is_foretold(simulated, short):
    measured = measured_cost(simulated, short, NAMES)
    rows = short.pose.shape[1] - 1
    assert measured.seconds(8, rows) == pytest.approx(RESET + rows * (FIXED + 8 * EACH))


def test_a_stall_of_the_machine_is_not_the_simulators(simulated, short, monkeypatch):
    monkeypatch.setattr(cost, "QUICK", 100.0)
    rolled, called = Simulated.readings, []

    def stalling(self, segments, settings):
        called.append(len(settings))
        if len(called) % cost.OFTEN == 0:
            self.clock.now += 5.0
        rolled(self, segments, settings)

    monkeypatch.setattr(Simulated, "readings", stalling)
    measured = measured_cost(simulated, short, [])
    assert measured.fixed == pytest.approx(FIXED)
    assert measured.each == pytest.approx(EACH)
