"""A residual whose weights are fitted to rollouts."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core.kernels import LANES
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.effects.residual_models import INPUTS, MOTION, ResidualProcess
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.residual_process import (
    Rows,
    by_row,
    learned,
    relearned,
    rollout_and_slopes,
)
from buggy_rl.estimation.rollout import AS_GIVEN, Simulation
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.planted import planted_drives, single_track

SIMULATION = Simulation(single_track)


def segments_with(effect, cars=2, seconds=12.0, horizon=1.0):
    [drives] = planted_drives([effect], cars=cars, seconds=seconds)
    return cut_segments(drives, horizon, horizon)


def rows_of(segments, group=None):
    group = torch.zeros(len(segments), dtype=torch.long) if group is None else group
    return Rows(segments, group, AS_GIVEN)


@pytest.fixture(scope="module")
def wrong():
    """Segments of cars whose motor turns them, which the simulator does not have."""
    return segments_with({"torque_steer": {"offset": 0.01}})


@pytest.fixture(scope="module")
def of_drives(wrong):
    """Two models, each learned from one drive, their recipe, and what was held out."""
    drive = wrong.recording
    rows = rows_of(wrong, drive)
    noise = noise_model(SIMULATION, wrong)
    found = learned(SIMULATION, rows_of(wrong, 1 - drive), 2, rows, noise)
    return found.models, found.recipe, rows


def distance(simulation, segments):
    square = simulation.residuals(segments)[0, ..., :2].square().sum(-1)
    return float(square.mean(1).sqrt().median())


def beside(model, dt):
    return replace(SIMULATION, standing=(ResidualAcceleration(model=model, strength=1.0, dt=dt),))


def test_rollouts_that_were_held_out_come_several_times_nearer(of_drives, wrong):
    models, _, rows = of_drives
    model = by_row(models, rows.group)
    assert distance(beside(model, wrong.dt), wrong) < 0.3 * distance(SIMULATION, wrong)


def test_gauss_newton_on_rollouts_goes_beyond_what_accelerations_tell(of_drives, wrong):
    _, recipe, _ = of_drives
    assert recipe.iterations
    fresh = segments_with({"torque_steer": {"offset": 0.01}}, cars=4)
    fresh = fresh[torch.nonzero(fresh.recording >= 2).flatten()]
    plain = replace(recipe, iterations=())
    models = (relearned(SIMULATION, rows_of(wrong), each) for each in (recipe, plain))
    full, steps = (distance(beside(model, wrong.dt), fresh) for model in models)
    assert full < 0.85 * steps


def test_a_right_simulator_is_left_as_it_is():
    right = segments_with({})
    drive = right.recording
    noise = noise_model(SIMULATION, right)
    found = learned(SIMULATION, rows_of(right, 1 - drive), 2, rows_of(right, drive), noise)
    with_it = distance(beside(by_row(found.models, drive), right.dt), right)
    assert with_it < distance(SIMULATION, right) + 1e-3  # within the noise of the camera


def test_each_model_learns_from_its_own_rows_alone(of_drives, wrong):
    models, recipe, _ = of_drives
    second = wrong[torch.nonzero(wrong.recording == 1).flatten()]
    alone = relearned(SIMULATION, rows_of(second), recipe)
    torch.testing.assert_close(models[0].mean, alone.mean)
    torch.testing.assert_close(models[0].weights, alone.weights, atol=0.01, rtol=0.0)


@pytest.fixture(scope="module")
def some_weights(wrong):
    """A model of a few segments with weights of some size, and those segments."""
    few = segments_with({"torque_steer": {"offset": 0.01}}, seconds=3.0, horizon=0.4)
    model = ResidualProcess(6)
    scale = few.velocity.flatten(0, 1).std(0)
    model.scale[:3].copy_(scale)
    model.weights.copy_(
        0.3 * torch.randn(model.size, 3, generator=torch.Generator().manual_seed(1))
    )
    return model, few


def test_derivatives_by_the_weights_are_those_of_rollouts(some_weights):
    model, few = some_weights
    rows = rows_of(few)
    residuals, slopes = rollout_and_slopes(SIMULATION, rows, by_row([model], rows.group))
    simulation = beside(model, few.dt)
    torch.testing.assert_close(residuals, simulation.residuals(few)[0], atol=1e-5, rtol=0)
    for feature, channel in ((0, 0), (3, 1), (model.size - 1, 2)):
        moved = []
        for sign in (1, -1):
            other = ResidualProcess(6)
            other.load_state_dict(model.state_dict())
            other.weights[feature, channel] += 0.02 * sign
            moved.append(beside(other, few.dt).residuals(few)[0])
        expected = (moved[0] - moved[1]) / 0.04
        error = (slopes[..., feature, channel] - expected).norm() / expected.norm()
        assert error < 0.05


def test_models_of_a_batch_are_the_same_as_each_alone():
    models = []
    for seed in range(3):
        model, random = ResidualProcess(5), torch.Generator().manual_seed(seed)
        for name in ("mean", "weights", "bound", "scale"):
            buffer = getattr(model, name)
            buffer.copy_(0.5 + torch.rand(buffer.shape, generator=random))
        models.append(model)
    owner, inputs = torch.tensor([2, 0, 1, 2]), torch.randn(4, INPUTS)
    together = by_row(models, owner)(inputs)
    apart = torch.stack([models[k](x) for k, x in zip(owner.tolist(), inputs, strict=True)])
    torch.testing.assert_close(together, apart)


def test_any_number_of_segments_is_rolled_out_with_a_model_of_each(of_drives, wrong):
    """Batches are filled up to the lanes of kernels; there is no model for what is filled in."""
    models, _, rows = of_drives
    count = 3 * LANES - 1  # one short, and so many that one more costs little
    many = torch.arange(count) % len(wrong)
    together = beside(by_row(models, rows.group[many]), wrong.dt).residuals(wrong[many])
    alone = beside(by_row(models, rows.group), wrong.dt).residuals(wrong)
    torch.testing.assert_close(together, alone[:, many], atol=1e-5, rtol=0)


def test_it_learns_nothing_from_what_the_sensor_alone_shows_wrong():
    """A rate gyro that reads too much changes no motion: an acceleration must not repair it."""
    biased = segments_with({"gyro_bias": {"bias": 0.15}})
    drive = biased.recording
    noise = noise_model(SIMULATION, biased)
    found = learned(SIMULATION, rows_of(biased, 1 - drive), 2, rows_of(biased, drive), noise)
    with_it = distance(beside(by_row(found.models, drive), biased.dt), biased)
    assert with_it < distance(SIMULATION, biased) + 2e-3


def test_it_is_silent_far_from_what_was_driven(of_drives):
    [model, _], _, _ = of_drives
    inputs = model.mean.expand(2, -1).clone()
    inputs[1, 0] = model.high[0] + 6 * model.scale[0]
    near, far = model(inputs)
    assert far.norm() < 1e-6 * near.norm()
    assert len(model.low) == MOTION
