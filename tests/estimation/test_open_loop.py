from dataclasses import replace
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.effects import make_effects
from buggy_rl.estimation.open_loop import (
    bootstrap_interval,
    measured_motion,
    open_loop,
    open_loop_error,
)
from buggy_rl.estimation.segments import Segments, cut_segments
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.engine import LearnedEngine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from buggy_rl.task.env import with_effects
from tests.drives import toy_drive

LATE = {"sensor_latency": {"dead_time": 0.05}}


@pytest.fixture
def segments() -> Segments:
    return as_measured(cut_segments([toy_drive("a", 400, 1)], 1.0, 0.6))


def as_measured(segments: Segments) -> Segments:
    """Segments whose rollouts start from what was measured."""
    return replace(segments, smooth_pose=segments.pose, smooth_velocity=segments.velocity)


def test_a_car_that_keeps_its_velocity_is_simulated_exactly_by_hold(segments: Segments):
    velocity = torch.tensor([1.0, 0.0, 0.0]).expand_as(segments.velocity)
    pose = torch.zeros_like(segments.pose)
    pose[..., 0] = 0.01 * torch.arange(131)
    straight = as_measured(replace(segments, pose=pose, velocity=velocity))
    made = open_loop(partial(make_engine, "hold"), straight)
    error = open_loop_error(made, measured_motion(straight), 0.01)
    assert made.batch_size == (len(segments), 101)
    assert_close(error.position[1.0], torch.zeros(len(segments)), atol=1e-5, rtol=0)


def test_errors_are_those_computed_by_hand():
    # A car standing still simulated as running off at 1 m/s along x, with 0.1 rad of heading error.
    steps = 101
    measured = TensorDict(
        {keys.POSE: torch.zeros(1, steps, 3), keys.VELOCITY: torch.zeros(1, steps, 3)}, [1, steps]
    )
    made = measured.clone()
    made[keys.POSE][..., 0] = 0.01 * torch.arange(steps)
    made[keys.POSE][..., 2] = 0.1 + 2 * torch.pi  # a whole turn is no error
    made[keys.VELOCITY][..., 0] = 1.0
    error = open_loop_error(made, measured, 0.01)
    # mean of (0.01 k)^2 for k = 1..100: 1e-4 * 100 * 101 * 201 / 6 / 100 = 0.33835
    assert error.position_mse[1.0].item() == pytest.approx(0.33835, rel=1e-5)
    assert error.position[0.3].item() == pytest.approx(0.3, rel=1e-5)
    assert error.yaw[1.0].item() == pytest.approx(0.1, abs=1e-5)
    assert error.velocity_mse[1.0][0].tolist() == [1.0, 0.0, 0.0]
    assert 3.0 not in error.position, "the rollout is 1 s long"


def test_the_warm_up_fills_a_models_memory_with_what_was_measured(segments: Segments):
    class Remembering(LearnedEngine):
        last: torch.Tensor

        def _advance(self, state, action):
            Remembering.last = state[keys.HISTORY].clone()
            return super()._advance(state, action)

    model = make_model(ModelConfig("mlp", options={"rows": 20}))
    short = cut_segments([toy_drive("a", 400, 1)], 0.01, 0.6)
    open_loop(lambda count: Remembering(count, model=model), as_measured(short))
    # The last step starts at row 30; its memory holds rows 11 to 29.
    rows = torch.cat([short.velocity, short.action], -1)[:, 11:30]
    assert_close(Remembering.last, rows)


def test_the_start_may_be_given_apart_from_what_was_measured(segments: Segments):
    start = torch.full_like(segments.velocity, 0.5)
    made = open_loop(partial(make_engine, "hold"), replace(segments, smooth_velocity=start))
    assert_close(made[keys.VELOCITY], torch.full_like(made[keys.VELOCITY], 0.5))


def test_a_simulator_with_a_late_sensor_shows_what_that_sensor_shows(segments: Segments):
    def late(count):
        return with_effects(make_engine("hold", count), make_effects(LATE))

    prompt, delayed = (open_loop(make, segments) for make in (partial(make_engine, "hold"), late))
    # Of a car that keeps its velocity a sensor shows the same late or not, from what it has shown
    # by the start on; what it shows later is not known there yet.
    assert_close(delayed[keys.VELOCITY][:, -1], segments.velocity[:, 30], atol=1e-5, rtol=0)
    assert_close(delayed[keys.POSE], prompt[keys.POSE], atol=1e-3, rtol=0)


def test_an_interval_covers_the_truth_as_often_as_it_says_when_neighbours_are_alike():
    generator = torch.Generator().manual_seed(0)
    covered, naive, trials = 0, 0, 200
    groups = torch.arange(40).repeat_interleave(10)
    for trial in range(trials):
        values = torch.randn(40, generator=generator).repeat_interleave(10)
        low, high = bootstrap_interval(values, groups, draws=400, seed=trial)
        covered += low < 0 < high
        low, high = bootstrap_interval(values, torch.arange(400), draws=400, seed=trial)
        naive += low < 0 < high
    assert 0.90 <= covered / trials <= 0.98
    assert naive / trials < 0.6, "windows taken for independent are too sure of themselves"
