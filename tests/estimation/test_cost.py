"""The time of a rollout is measured, not guessed."""

import time

import pytest

from buggy_rl.estimation.cost import measured_cost
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.planted import QUIET, planted_drives
from tests.plain_env import PlainCar

STEP, EACH, RESET = 0.01, 2e-4, 0.2  # [s]


class Sleepy(PlainCar):
    """A step takes 10 ms and 0.2 ms for each environment, a reset 0.2 s."""

    substeps = 1

    def _step(self, tensordict):
        time.sleep(STEP + EACH * self.batch_size[0])
        return super()._step(tensordict)

    def _reset(self, tensordict=None, **keywords):
        time.sleep(RESET)
        return super()._reset(tensordict, **keywords)


@pytest.fixture(scope="module")
def short():
    return cut_segments(planted_drives([{}], 1, 5.0, quality=QUIET)[0], 1.0, 1.0).shortened(10)


def test_fixed_time_time_of_each_environment_and_of_a_reset_are_told_apart(short):
    cost = measured_cost(Simulation(Sleepy), short, [])
    assert STEP < cost.fixed < 2 * STEP
    assert cost.each == pytest.approx(EACH, rel=0.7)
    assert RESET < cost.reset < 3 * RESET
    assert cost.effects == 0


def test_effects_in_the_stack_cost_time(short):
    names = ["steering_gain", "viscous_drag", "sensor_latency", "steering_backlash"]
    cost = measured_cost(Simulation(PlainCar), short, names)
    assert cost.effects > 0
    assert cost.seconds(100, 10, 1.0) > cost.seconds(100, 10)
