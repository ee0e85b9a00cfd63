import pytest
import torch
from torch.testing import assert_close

from buggy_rl.core import keys
from buggy_rl.recordings.windows import windows
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from buggy_rl.simulators.learned.normalisation import coasting_deceleration, resting_throttle
from buggy_rl.simulators.learned.training import (
    Training,
    TrainingConfig,
    one_step_loss,
    rollout_loss,
)
from tests.drives import toy_drive

QUICK = TrainingConfig(epochs=4, horizon=10, stride=10, batch_size=64)


def training(config: TrainingConfig, rows: int = 2) -> Training:
    torch.manual_seed(config.seed)
    model = make_model(ModelConfig("mlp", options={"rows": rows, "hidden": [16]}))
    return Training(model, [toy_drive("a", 600, 1)], [toy_drive("b", 300, 2)], config)


class Exact(torch.nn.Module):
    """The equations of `toy_drive` as a model."""

    rows = 1
    input_scale = torch.ones(5)
    output_scale = torch.ones(3)

    def change(self, history):
        vx, vy, yaw_rate, throttle, steering = history[..., -1, :].unbind(-1)
        return 0.01 * torch.stack(
            [
                2 * (throttle + 1) - 1.5 * vx,
                -0.5 * yaw_rate - 5 * vy,
                8 * (steering * vx - yaw_rate),
            ],
            -1,
        )


def test_both_losses_vanish_for_the_true_dynamics_and_for_no_other():
    cut = windows([toy_drive("a", 300, 1)], 41, 10)
    exact = Exact()
    assert one_step_loss(exact, cut).item() < 1e-10
    assert rollout_loss(exact, cut, 40, 0.01).item() < 1e-8
    late = cut.clone()
    late[keys.ACTION] = late[keys.ACTION].roll(3, 1)
    assert rollout_loss(exact, late, 40, 0.01).item() > 1e-4


def test_the_rollout_loss_runs_on_the_models_own_states():
    # Measured velocities after the start are only compared with, never fed in: what a rollout
    # makes does not change when they do, so the gradient with respect to the model is all there is.
    cut = windows([toy_drive("a", 300, 1)], 41, 10)
    seen = []

    class Spy(Exact):
        def change(self, history):
            seen.append(history[..., -1, :3].clone())
            return super().change(history)

    disturbed = cut.clone()
    disturbed[keys.VELOCITY][:, 1:] += 1.0
    rollout_loss(Spy(), cut, 10, 0.01)
    calm, seen = seen, []
    rollout_loss(Spy(), disturbed, 10, 0.01)
    assert_close(torch.stack(seen), torch.stack(calm), rtol=0, atol=0)


@pytest.mark.parametrize("loss", ["one_step", "rollout"])
def test_training_lowers_the_validation_loss_by_half_at_least(loss):
    run = training(TrainingConfig(loss=loss, epochs=20, horizon=10, stride=5, batch_size=16))
    before = run._validate()
    list(run.run())
    assert run._validate() < 0.5 * before


def test_the_model_ends_with_its_best_weights():
    run = training(QUICK)
    losses = [metrics["validation_loss"] for metrics in run.run()]
    assert run._validate() == pytest.approx(min(losses), rel=1e-6)


def test_a_resumed_training_ends_bit_for_bit_like_one_that_never_stopped():
    whole = training(QUICK)
    expected = list(whole.run())
    first = training(QUICK)
    steps = first.run()
    seen = [next(steps), next(steps)]
    state = first.state_dict()
    second = training(QUICK)
    second.load_state_dict(state)
    seen += list(second.run())
    assert seen == expected
    for name, tensor in whole.model.state_dict().items():
        assert torch.equal(tensor, second.model.state_dict()[name]), name


def test_mirrored_training_sees_as_many_left_turns_as_right_ones():
    config = TrainingConfig(preparation="mirrored", horizon=10, stride=10)
    run = training(config)
    steering = run.training[keys.ACTION][..., 1]
    assert steering.mean().abs() < 1e-6
    assert training(QUICK).training[keys.ACTION][..., 1].mean().abs() > 1e-3


def test_a_loss_that_is_not_finite_stops_the_training_with_advice():
    run = training(QUICK)
    run.model.output_scale.fill_(float("nan"))
    with pytest.raises(FloatingPointError, match="learning_rate"):
        next(run.run())


def test_the_resting_throttle_lies_below_the_throttle_that_starts_the_car():
    # A car that sets off at once above throttle -0.4 (2 m/s^2) and never below.
    drive = toy_drive("a", 400, 0)
    throttle = torch.full((400,), -0.5)
    throttle[200:] = -0.3
    speed = torch.zeros(400)
    speed[200:] = 0.02 * torch.arange(200)
    drive.data[keys.ACTION][:, 0] = throttle
    drive.data[keys.VELOCITY] = torch.stack([speed, 0 * speed, 0 * speed], -1)
    assert resting_throttle([drive]) == pytest.approx(-0.5)


def test_a_throttle_that_was_never_tried_from_rest_does_not_count_as_rest():
    drive = toy_drive("a", 400, 0)
    throttle = torch.full((400,), -1.0)
    throttle[200:] = 0.2
    speed = torch.zeros(400)
    speed[200:] = 0.03 * torch.arange(200)
    drive.data[keys.ACTION][:, 0] = throttle
    drive.data[keys.VELOCITY] = torch.stack([speed, 0 * speed, 0 * speed], -1)
    assert resting_throttle([drive]) == pytest.approx(-0.98)


def test_the_coasting_deceleration_is_the_least_that_was_seen():
    # Without drive, 2 m/s down at 0.8 m/s^2, then at 0.4 m/s^2.
    drive = toy_drive("a", 300, 0)
    rate = torch.where(torch.arange(300) < 100, 0.008, 0.004)
    drive.data[keys.ACTION][:, 0] = -1.0
    vx = 2.0 - rate.cumsum(0)
    drive.data[keys.VELOCITY] = torch.stack([vx, 0 * vx, 0 * vx], -1)
    assert coasting_deceleration([drive]) == pytest.approx(0.4, rel=1e-3)


def test_without_a_standing_car_only_no_throttle_counts_as_rest():
    drive = toy_drive("a", 400, 0)
    drive.data[keys.VELOCITY][:, 0] += 1.0
    assert resting_throttle([drive]) == pytest.approx(-0.98)
