from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from buggy_rl import keys
from buggy_rl.engines import make_engine
from buggy_rl.engines.learned import LearnedEngine
from buggy_rl.identification.open_loop import bootstrap_interval, open_loop, open_loop_error
from buggy_rl.models.factory import ModelConfig, make_model
from buggy_rl.recordings.windows import windows
from tests.drives import toy_drive


@pytest.fixture
def cut() -> TensorDict:
    return windows([toy_drive("a", 400, 1)], 131, 60)


def test_a_car_that_keeps_its_velocity_is_simulated_exactly_by_hold(cut: TensorDict):
    cut[keys.VELOCITY][:] = torch.tensor([1.0, 0.0, 0.0])
    cut[keys.POSE][:] = 0
    cut[keys.POSE][..., 0] = 0.01 * torch.arange(131)
    made = open_loop(partial(make_engine, "hold"), cut)
    error = open_loop_error(made, cut[:, 30:], 0.01)
    assert made.batch_size == (len(cut), 101)
    assert_close(error.position[1.0], torch.zeros(len(cut)), atol=1e-5, rtol=0)


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


def test_the_warm_up_fills_a_models_memory_with_what_was_measured(cut: TensorDict):
    class Remembering(LearnedEngine):
        last: torch.Tensor

        def _advance(self, state, action):
            Remembering.last = state[keys.HISTORY].clone()
            return super()._advance(state, action)

    model = make_model(ModelConfig("mlp", options={"rows": 20}))
    open_loop(lambda count: Remembering(count, model=model), cut[:, :32])
    # The last step starts at row 30; its memory holds rows 11 to 29.
    rows = torch.cat([cut[keys.VELOCITY], cut[keys.ACTION]], -1)[:, 11:30]
    assert_close(Remembering.last, rows)


def test_chunks_give_the_same_rollouts_as_one_batch(cut: TensorDict):
    make = partial(make_engine, "hold")
    assert_close(open_loop(make, cut, chunk=2)[keys.POSE], open_loop(make, cut)[keys.POSE])


def test_the_start_may_be_given_apart_from_what_was_measured(cut: TensorDict):
    start = torch.full_like(cut[keys.VELOCITY], 0.5)[:, :31]
    made = open_loop(partial(make_engine, "hold"), cut, start)
    assert_close(made[keys.VELOCITY], torch.full_like(made[keys.VELOCITY], 0.5))


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
